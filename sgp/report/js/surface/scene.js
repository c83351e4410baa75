// The picture of a surface: camera, mesh, light and section plane, drawn by three.js (global THREE).

import { section } from "./mesh.js";

export const MOST_EXAGGERATION = 10;
const TURN_RAD = Math.PI / 36;
const PAN_PX = 40;
const MARGIN = 0.9;
const LEAST_EXAGGERATION = 0.001; // a mesh of no height has no normals
/** Directions toward the camera. */
const VIEWS = { front: [0, 0, 1], tilted: [0.28, -0.66, 0.7], side: [0.94, -0.1, 0.34] };

export class Scene {
  /** Draw on a canvas; `drawn` is called after each picture. */
  constructor(canvas, drawn) {
    const context = canvas.getContext("webgl2", { alpha: true, antialias: true, preserveDrawingBuffer: true });
    if (context === null) throw new Error("the browser has no WebGL2");
    Object.assign(this, { canvas, drawn, waiting: 0, exaggeration: 1, cut: null });
    this.renderer = new THREE.WebGLRenderer({ canvas, context });
    this.renderer.setClearColor(0x000000, 0);
    this.renderer.localClippingEnabled = true;
    this.camera = new THREE.OrthographicCamera();
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.controls.addEventListener("change", () => this.redraw());
    this.controls.addEventListener("start", () => (this.looked = null));
    this.sun = new THREE.DirectionalLight(0xffffff, 0.85 * Math.PI);
    this.plane = new THREE.Plane();
    this.material = new THREE.MeshLambertMaterial({ side: THREE.DoubleSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 });
    this.lineMaterial = new THREE.LineMaterial({ color: 0xd81b60, linewidth: 3 });
    this.mesh = new THREE.Mesh(new THREE.BufferGeometry(), this.material);
    this.outline = new THREE.LineSegments2(new THREE.LineSegmentsGeometry(), this.lineMaterial);
    this.outline.visible = false;
    this.mesh.add(this.outline);
    this.world = new THREE.Scene();
    this.world.add(this.mesh, this.sun, new THREE.AmbientLight(0xffffff, 0.15 * Math.PI));
    this.caster = new THREE.Raycaster();
  }

  /** Show a mesh of `meshOf`, seen from the side that the camera of the recording does not see well. */
  open(made, heights) {
    this.made = made;
    this.heights = heights;
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(made.positions, 3));
    geometry.setAttribute("uv", new THREE.BufferAttribute(made.uv, 2));
    geometry.setIndex(new THREE.BufferAttribute(made.index, 1));
    geometry.computeVertexNormals();
    geometry.computeBoundingSphere();
    this.mesh.geometry.dispose();
    this.mesh.geometry = geometry;
    this.half = heights.half;
    this.radius = Math.hypot(...this.half, (MOST_EXAGGERATION * (made.range[1] - made.range[0])) / 2) || 1;
    this.look("tilted");
  }

  /** Lay a picture of the size of the map on the surface. */
  cover(picture) {
    this.material.map?.dispose();
    const texture = new THREE.CanvasTexture(picture);
    texture.colorSpace = THREE.SRGBColorSpace;
    texture.anisotropy = this.renderer.capabilities.getMaxAnisotropy();
    this.material.map = texture;
    this.material.needsUpdate = true;
    this.redraw();
  }

  exaggerate(factor) {
    this.exaggeration = this.mesh.scale.z = Math.max(factor, LEAST_EXAGGERATION);
    if (this.looked) this.look(this.looked);
    this.clip(this.cut);
  }

  light([x, y, z]) {
    this.sun.position.set(x, y, z);
    this.redraw();
  }

  /** Remove what lies beyond a plane {axis: 0, 1 or 2, value}, and draw its outline; null shows all. */
  clip(cut) {
    this.cut = cut;
    this.outline.visible = cut !== null;
    this.material.clippingPlanes = cut ? [this.plane] : null;
    if (cut) {
      const { axis, value } = cut;
      const sign = axis === 1 ? 1 : -1;
      const relative = axis === 2 ? value - this.made.middle : value;
      this.plane.normal.set(0, 0, 0).setComponent(axis, sign);
      this.plane.constant = -sign * relative * (axis === 2 ? this.exaggeration : 1);
      const segments = section(this.made, axis, relative);
      this.outline.geometry.dispose();
      this.outline.geometry = new THREE.LineSegmentsGeometry();
      if (segments.length > 0) this.outline.geometry.setPositions(segments);
      this.outline.visible = segments.length > 0;
    }
    this.redraw();
  }

  /** Look from the front, tilted or from the side, at the complete surface, until it is turned or moved. */
  look(name) {
    this.looked = name;
    const direction = new THREE.Vector3(...VIEWS[name]).normalize();
    this.controls.target.set(0, 0, 0);
    this.camera.position.copy(direction.multiplyScalar(2 * this.radius));
    this.camera.near = 0;
    this.camera.far = 8 * this.radius;
    this.controls.update();
    this.camera.zoom = this.size ? this.fitting() : 1;
    this.camera.updateProjectionMatrix();
    this.redraw();
  }

  /** Return the zoom at which the box around the surface fills the picture but for a margin. */
  fitting() {
    this.camera.updateMatrixWorld();
    const [x, y] = this.half;
    const z = (this.exaggeration * (this.made.range[1] - this.made.range[0])) / 2;
    let most = 0;
    for (const corner of [[x, y, z], [-x, y, z], [x, -y, z], [-x, -y, z]]) {
      const { x: across, y: up } = new THREE.Vector3(...corner).transformDirection(this.camera.matrixWorldInverse);
      const length = Math.hypot(...corner);
      most = Math.max(most, (Math.abs(across) * length) / this.camera.right, (Math.abs(up) * length) / this.camera.top);
    }
    return MARGIN / (most || 1);
  }

  /** Fit the camera to the size of the canvas in pixels of the page. */
  resize(width, height) {
    this.renderer.setPixelRatio(window.devicePixelRatio || 1);
    this.renderer.setSize(width, height, false);
    this.size = [width, height];
    const [across, up] = [(this.radius * width) / height, this.radius];
    Object.assign(this.camera, { left: -across, right: across, top: up, bottom: -up });
    if (this.looked) this.look(this.looked);
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  /** Pixels of the page for a unit of length across the line of sight. */
  get scale() {
    return (this.size[0] * this.camera.zoom) / (this.camera.right - this.camera.left);
  }

  redraw() {
    if (this.size) this.waiting ||= requestAnimationFrame(() => this.draw());
  }

  draw() {
    cancelAnimationFrame(this.waiting);
    this.waiting = 0;
    this.renderer.render(this.world, this.camera);
    this.drawn();
  }

  /** Return where the surface at a place of the map is on the canvas, in pixels of the page. */
  project(place) {
    const [width, height] = this.size;
    const [x, y, z] = this.heights.point(...place);
    const at = new THREE.Vector3(x, y, (z - this.made.middle) * this.exaggeration).project(this.camera);
    return [((at.x + 1) / 2) * width, ((1 - at.y) / 2) * height];
  }

  /** Return the directions of x, y and z on the canvas. */
  axes() {
    return [0, 1, 2].map((axis) => {
      const along = new THREE.Vector3().setComponent(axis, 1).transformDirection(this.camera.matrixWorldInverse);
      return [along.x, -along.y];
    });
  }

  /** Return the place of the map at a place of the canvas, or null. */
  hit(left, top) {
    const [width, height] = this.size;
    this.caster.setFromCamera(new THREE.Vector2((2 * left) / width - 1, 1 - (2 * top) / height), this.camera);
    const hits = this.caster.intersectObject(this.mesh, false);
    const found = hits.find(({ point }) => this.cut === null || this.plane.distanceToPoint(point) >= 0);
    if (!found) return null;
    const { columns, rows, pixelSize, half } = this.heights;
    return [(found.uv.x * columns - 0.5) * pixelSize - half[0], half[1] - ((1 - found.uv.y) * rows - 0.5) * pixelSize];
  }

  /** Turn, move or zoom by a key; returns whether it was one of theirs. */
  key({ key, shiftKey }) {
    const ways = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const looks = { 0: "tilted", 1: "front", 2: "side" };
    if (key in ways) this.looked = null;
    if (key in ways && shiftKey) this.controls.pan(...ways[key].map((one) => PAN_PX * one));
    else if (key in ways) {
      this.controls.rotateLeft(TURN_RAD * ways[key][0]);
      this.controls.rotateUp(TURN_RAD * ways[key][1]);
    } else if (key === "+" || key === "=") this.zoom(1.25);
    else if (key === "-") this.zoom(0.8);
    else if (key in looks) this.look(looks[key]);
    else return false;
    return true;
  }

  zoom(factor) {
    this.looked = null;
    this.camera.zoom *= factor;
    this.camera.updateProjectionMatrix();
    this.redraw();
  }
}
