// The fragment shader: the colour of a pixel from the embedded maps and the light.

/** Modes of the shader; those below CURVATURE shade. */
export const MODES = {
  shaded: 0,
  matte: 1,
  specular: 2,
  shape: 3,
  detail: 4,
  curvature: 5,
  albedo: 6,
  normals: 7,
  scalar: 8,
  captured: 9,
};

export const VERTEX = `#version 300 es
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  gl_Position = vec4(4.0 * corner - 1.0, 0.0, 1.0);
}`;

export const FRAGMENT = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp usampler2D;
uniform usampler2D uNormals, uShape, uScalar, uHeight, uInvented;
uniform sampler2D uAlbedo, uColours, uFrameA, uFrameB, uFrameC;
uniform int uMode, uLevel;
uniform ivec2 uSize;            // of the map, or of one of its tiles
uniform vec2 uOffset, uWhole;   // first pixel of the tile, and size of the whole map
uniform vec2 uOrigin;           // of the map on the canvas, from its top left corner
uniform float uZoom;            // pixels of the canvas for each pixel of the map
uniform float uCanvasHeight;
uniform vec3 uLight;            // unit vector, or a position in pixels of the map for a near light
uniform bool uNear, uHasShape, uHasHeight, uHasAlbedo, uMark, uOutline;
uniform float uReference;       // distance at which a near light has strength 1
uniform float uExaggeration, uGain, uGloss, uShine, uPixelSize;
uniform vec2 uScalarRange;      // samples at the ends of the colour scale
uniform vec2 uHeightStep;       // offset and step of the height in pixels
uniform float uCurvatureRange;
uniform vec3 uFrameWeights;
out vec4 colour;

const float STEPS = 4094.0;

vec3 decoded(uvec4 s) {
  vec2 e = (vec2(s.xy) - 1.0) * (2.0 / STEPS) - 1.0;
  vec3 v = vec3(e, 1.0 - abs(e.x) - abs(e.y));
  if (v.z < 0.0) v.xy = (1.0 - abs(v.yx)) * vec2(v.x < 0.0 ? -1.0 : 1.0, v.y < 0.0 ? -1.0 : 1.0);
  return normalize(v);
}
vec3 toLinear(vec3 c) {
  return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c));
}
vec3 toSrgb(vec3 c) {
  c = clamp(c, 0.0, 1.0);
  return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
}

// The four pixels around a place, and their shares. From 4 pixels of the canvas for each of the
// map, it is the nearest pixel alone.
ivec2 taps[4];
float shares[4];
void place(vec2 p, ivec2 size) {
  vec2 q = p * exp2(-float(uLevel));
  vec2 start = uZoom < 4.0 ? floor(q - 0.5) : floor(q);
  vec2 f = uZoom < 4.0 ? q - 0.5 - start : vec2(0.0);
  for (int k = 0; k < 4; k++) {
    ivec2 o = ivec2(k & 1, k >> 1);
    taps[k] = clamp(ivec2(start) + o, ivec2(0), size - 1);
    shares[k] = (o.x == 1 ? f.x : 1.0 - f.x) * (o.y == 1 ? f.y : 1.0 - f.y);
  }
}
vec4 vectorAt(usampler2D map) {
  vec3 sum = vec3(0.0);
  float known = 0.0;
  for (int k = 0; k < 4; k++) {
    uvec4 s = texelFetch(map, taps[k], uLevel);
    if (s.x == 0u) continue;
    sum += shares[k] * decoded(s);
    known += shares[k];
  }
  float size = length(sum);
  return vec4(size > 0.0 ? sum / size : vec3(0.0), known);
}
vec2 scalarAt(usampler2D map) {
  float sum = 0.0, known = 0.0;
  for (int k = 0; k < 4; k++) {
    uint s = texelFetch(map, taps[k], uLevel).x;
    if (s == 0u) continue;
    sum += shares[k] * float(s);
    known += shares[k];
  }
  return vec2(known > 0.0 ? sum / known : 0.0, known);
}
vec3 albedoAt() {
  if (!uHasAlbedo) return vec3(1.0);
  // Pixels outside the mask are black in it.
  vec3 sum = vec3(0.0);
  float known = 0.0;
  for (int k = 0; k < 4; k++) {
    float share = texelFetch(uNormals, taps[k], uLevel).x == 0u ? 0.0 : shares[k];
    sum += share * toLinear(texelFetch(uAlbedo, taps[k], uLevel).rgb);
    known += share;
  }
  return sum / max(known, 1e-6);
}

// The shortest rotation that takes pole to z, applied to v; and its inverse.
vec3 turned(vec3 v, vec3 pole, float sign) {
  vec2 a = sign * vec2(pole.y, -pole.x);
  float c = pole.z;
  if (c < -0.9999) return vec3(v.x, -v.y, -v.z);
  float d = (a.x * v.x + a.y * v.y) / (1.0 + c);
  return vec3(
    c * v.x + a.y * v.z + a.x * d,
    c * v.y - a.x * v.z + a.y * d,
    c * v.z + a.x * v.y - a.y * v.x
  );
}
vec3 exaggerated(vec3 v) {
  return normalize(vec3(v.xy * uExaggeration, v.z));
}
float curvatureAt(vec2 p, ivec2 size, out float known) {
  ivec2 at = clamp(ivec2(floor(p * exp2(-float(uLevel)))), ivec2(1), max(size - 2, ivec2(1)));
  uvec4 s[4];
  s[0] = texelFetch(uNormals, at + ivec2(1, 0), uLevel);
  s[1] = texelFetch(uNormals, at - ivec2(1, 0), uLevel);
  s[2] = texelFetch(uNormals, at - ivec2(0, 1), uLevel);
  s[3] = texelFetch(uNormals, at + ivec2(0, 1), uLevel);
  known = s[0].x == 0u || s[1].x == 0u || s[2].x == 0u || s[3].x == 0u ? 0.0 : 1.0;
  float across = decoded(s[0]).x - decoded(s[1]).x;
  float down = decoded(s[2]).y - decoded(s[3]).y;
  return (across + down) / (4.0 * exp2(float(uLevel)) * uPixelSize);
}
float markedAt(vec2 p, ivec2 size) {
  place(p, size);
  return step(1.5, scalarAt(uInvented).x);
}
vec3 mapped(float t) {
  return texelFetch(uColours, ivec2(int(clamp(t, 0.0, 1.0) * 255.0 + 0.5), 0), 0).rgb;
}

void main() {
  vec2 p = (vec2(gl_FragCoord.x, uCanvasHeight - gl_FragCoord.y) - uOrigin) / uZoom;
  colour = vec4(0.0);
  if (any(lessThan(p, vec2(0.0))) || any(greaterThanEqual(p, vec2(uSize)))) return;
  ivec2 size = uSize >> uLevel;
  place(p, size);
  float known = 1.0;
  vec3 shown;
  if (uMode == ${MODES.captured}) {
    vec2 at = p / vec2(uSize);
    shown = uFrameWeights.x * toLinear(texture(uFrameA, at).rgb)
      + uFrameWeights.y * toLinear(texture(uFrameB, at).rgb)
      + uFrameWeights.z * toLinear(texture(uFrameC, at).rgb);
    shown = toSrgb(uGain * shown);
  } else if (uMode == ${MODES.scalar}) {
    vec2 found = scalarAt(uScalar);
    known = found.y;
    shown = mapped((found.x - uScalarRange.x) / (uScalarRange.y - uScalarRange.x));
  } else if (uMode == ${MODES.curvature}) {
    float found = curvatureAt(p, size, known);
    shown = mapped(0.5 + 0.5 * found / uCurvatureRange);
  } else {
    vec4 normal = vectorAt(uNormals);
    vec4 shape = uHasShape ? vectorAt(uShape) : vec4(0.0, 0.0, 1.0, 1.0);
    known = normal.w;
    vec3 detail = exaggerated(turned(normal.xyz, shape.xyz, 1.0));
    vec3 n = uHasShape ? turned(detail, shape.xyz, -1.0) : exaggerated(normal.xyz);
    if (uMode == ${MODES.shape}) n = shape.xyz;
    if (uMode == ${MODES.detail}) n = detail;
    vec3 l = uLight;
    float strength = 1.0;
    if (uNear) {
      float z = uHasHeight ? uHeightStep.x + uHeightStep.y * (scalarAt(uHeight).x - 1.0) : 0.0;
      vec2 at = p + uOffset - 0.5 * uWhole;
      vec3 way = uLight - vec3(at.x, -at.y, z);
      float far = max(length(way), 1e-6);
      l = way / far;
      strength = uReference * uReference / (far * far);
    }
    float lit = strength * max(0.0, dot(n, l));
    if (uMode == ${MODES.albedo}) shown = toSrgb(uGain * albedoAt());
    else if (uMode == ${MODES.normals}) shown = 0.5 + 0.5 * n;
    else if (uMode == ${MODES.shaded}) shown = toSrgb(uGain * lit * albedoAt());
    else if (uMode == ${MODES.specular}) {
      vec3 h = normalize(l + vec3(0.0, 0.0, 1.0));
      float glint = lit > 0.0 ? strength * pow(max(0.0, dot(n, h)), uShine) : 0.0;
      shown = toSrgb(uGain * ((1.0 - uGloss) * lit * albedoAt() + uGloss * glint));
    } else shown = toSrgb(vec3(uGain * lit));
  }
  if (uMark && uOutline) {
    // Pixels of the canvas within 3 of a marked one.
    float near = 0.0, inside = markedAt(p, size);
    for (int k = 0; k < 8; k++) near = max(near, markedAt(p + 3.0 / uZoom * vec2(cos(0.785398 * float(k)), sin(0.785398 * float(k))), size));
    shown = mix(shown, vec3(1.0, 0.55, 0.0), near * (1.0 - inside));
  } else if (uMark) {
    // Stripes: a colour alone would be lost on coloured maps, and to some eyes.
    float invented = (scalarAt(uInvented).x - 1.0) / 253.0;
    float stripe = mod(gl_FragCoord.x + gl_FragCoord.y, 10.0) < 3.0 ? 0.85 : 0.0;
    shown = mix(shown, vec3(1.0, 0.55, 0.0), stripe * step(0.5, invented));
  }
  colour = vec4(shown, 1.0) * known;
}`;
