"""The core modules, and the test files that must detect a fault in each, fastest first."""

from __future__ import annotations

_SPHERES = "calibration/spheres"
_VALUES, _BY_CLOCK = "rig/test_shooting_values.py", "rig/test_shots_by_clock.py"
_LINES = "acquisition/test_session_lines.py"
_SESSION = (
    "acquisition/test_session_golden.py",
    "acquisition/test_session_reader.py",
    _LINES,
    "acquisition/test_session_writer.py",
    "acquisition/test_session_faults.py",
    "acquisition/test_resume.py",
    "acquisition/test_resume_left_out.py",
    "acquisition/test_resume_refusals.py",
)
_PARTS = "calibration/test_sphere_parts.py"
_SEARCH = "calibration/test_sphere_search.py"
_OUTLINE = ("calibration/test_outline_parts.py", "calibration/test_outline.py")
_MARKS = "calibration/test_sphere_marks.py"
_LIGHTS = "calibration/test_sphere_lights.py"
_WHOLE_CALIBRATION = (_LIGHTS, _PARTS, "calibration/test_spheres_simulated.py")
_DETAIL = "processing/detail"

TARGETS: dict[str, tuple[str, ...]] = {
    "acquisition/engine/rejection.py": (
        "acquisition/test_references.py",
        "acquisition/test_rejection.py",
        "acquisition/test_short_brackets.py",
    ),
    "acquisition/engine/shot_order.py": (
        "acquisition/test_agenda.py",
        "acquisition/test_judging_order.py",
    ),
    "acquisition/engine/recording_run.py": (
        "acquisition/test_engine.py",
        "acquisition/test_engine_ctrl_c.py",
        "acquisition/test_engine_lost_shots.py",
        "acquisition/test_engine_refusals.py",
        "acquisition/test_engine_sequences.py",
        "acquisition/test_engine_slow_disk.py",
        "acquisition/test_engine_disk.py",
        "acquisition/test_set_aside.py",
    ),
    "acquisition/session/journal.py": ("acquisition/test_journal.py", _LINES),
    "acquisition/session/journal_frames.py": ("acquisition/test_recorded.py", *_SESSION),
    "acquisition/session/open_shots.py": (
        "acquisition/test_recorded.py",
        "acquisition/test_resume.py",
        "acquisition/test_resume_left_out.py",
        "acquisition/test_resume_refusals.py",
    ),
    "acquisition/session/verify.py": _SESSION,
    "rig/shooting/keep_alive.py": (_VALUES,),
    "rig/shooting/lights_off.py": ("rig/test_dark.py", "rig/test_rig_signals.py"),
    "rig/shooting/shot_times.py": (_VALUES,),
    "rig/shooting/frame_proof.py": (_VALUES, _BY_CLOCK, "rig/test_rig_shoot.py"),
    "rig/shooting/sequence.py": (_VALUES, _BY_CLOCK, "rig/test_rig_sequence.py"),
    "rig/shooting/shooting.py": (_VALUES, _BY_CLOCK, "rig/test_rig_shoot.py"),
    "rig/shooting/shot.py": (_VALUES,),
    "rig/board/protocol.py": ("rig/test_protocol_lines.py",),
    "rig/board/replies.py": ("rig/test_board_replies.py",),
    "calibration/radiance/developer.py": (
        "calibration/test_radiance_limits.py",
        "calibration/test_radiance.py",
    ),
    "calibration/radiance/stack.py": (
        "calibration/test_radiance_limits.py",
        "calibration/test_radiance.py",
        "calibration/test_raw_stack.py",
    ),
    "calibration/flat/pixel_part.py": ("calibration/test_flat.py",),
    "calibration/flat/card.py": ("calibration/test_flat.py",),
    **{
        f"calibration/sensor/{name}.py": ("calibration/test_sensor.py",)
        for name in (
            "calibrate",
            "dark_frames",
            "photon_transfer",
            "recorded_series",
            "series_points",
        )
    },
    f"{_SPHERES}/calibrate.py": _WHOLE_CALIBRATION,
    f"{_SPHERES}/geometry/cone.py": (
        "calibration/test_robust_fits.py",
        "calibration/test_outline.py",
    ),
    f"{_SPHERES}/geometry/ellipse.py": (
        "calibration/test_robust_fits.py",
        "calibration/test_outline.py",
    ),
    f"{_SPHERES}/propose/edge_search.py": (_SEARCH, _PARTS),
    f"{_SPHERES}/solve/average_directions.py": ("calibration/test_light_uncertainty.py",),
    f"{_SPHERES}/highlights/highlights.py": ("calibration/test_highlights.py", _PARTS),
    f"{_SPHERES}/judge/input_tests.py": ("calibration/test_input_tests.py",),
    f"{_SPHERES}/solve/joint_refinement.py": (
        "calibration/test_light_positions.py",
        "calibration/test_light_uncertainty.py",
    ),
    f"{_SPHERES}/solve/light_positions.py": ("calibration/test_light_positions.py", _PARTS),
    f"{_SPHERES}/outline/limb.py": ("calibration/test_outline.py",),
    f"{_SPHERES}/outline/limb_fit.py": ("calibration/test_limb_fit.py",),
    f"{_SPHERES}/propose/sphere_marks.py": (_MARKS, _PARTS),
    f"{_SPHERES}/outline/outline.py": (*_OUTLINE, _PARTS),
    f"{_SPHERES}/outline/outline_noise.py": ("calibration/test_light_uncertainty.py",),
    f"{_SPHERES}/solve/sphere_positions.py": (_PARTS, "calibration/test_light_positions.py"),
    f"{_SPHERES}/geometry/reflection.py": (
        "calibration/test_reflection.py",
        "calibration/test_light_positions.py",
    ),
    f"{_SPHERES}/geometry/robust.py": ("calibration/test_robust_fits.py",),
    f"{_SPHERES}/propose/sphere_selection.py": (_SEARCH, _PARTS),
    f"{_SPHERES}/solve/sphere_calibration.py": (_PARTS,),
    f"{_SPHERES}/outline/sphere_image.py": (_PARTS,),
    f"{_SPHERES}/highlights/spot.py": (
        "calibration/test_spot.py",
        "calibration/test_highlights.py",
    ),
    **{
        f"processing/stereo/{name}.py": (
            "processing/test_photometric_stereo.py",
            "processing/test_photometric_near.py",
        )
        for name in (
            "cauchy",
            "least_squares",
            "light_model",
            "trimmed",
        )
    },
    **{
        f"processing/stereo/{name}.py": (
            "processing/test_photometric_best.py",
            "processing/test_photometric_stereo.py",
        )
        for name in ("best", "reflectance_fit")
    },
    "processing/stereo/pixel_algebra.py": (
        "processing/test_photometric_stereo.py",
        "processing/test_photometric_near.py",
        "processing/test_photometric_noise.py",
    ),
    **{
        f"processing/stereo/{name}.py": ("processing/test_tile_least_squares.py",)
        for name in ("frames", "tile_kernels", "tile_least_squares")
    },
    "processing/stereo/image_noise.py": (
        "processing/test_image_noise.py",
        "processing/test_photometric_noise.py",
    ),
    "processing/stereo/frame_normals.py": ("processing/test_frame_normals.py",),
    "processing/stereo/normals_and_albedo.py": (
        "processing/test_photometric_stereo.py",
        "processing/test_photometric_near.py",
    ),
    "processing/curvatures/slopes.py": ("processing/test_curvature.py",),
    **{
        f"processing/noise/{name}.py": ("processing/test_normal_uncertainty.py",)
        for name in (
            "sample_judgement",
            "light_table",
            "pixel_variances",
            "reference",
            "reflectance_residual",
            "reference_solver",
            "tangents",
        )
    },
    "processing/noise/tile_reference.py": (
        "processing/test_tile_reference.py",
        "processing/test_normal_uncertainty.py",
    ),
    "processing/noise/pixel_variances.py": (
        "processing/test_model_error.py",
        "processing/test_normal_uncertainty.py",
    ),
    **{
        f"processing/{name}.py": ("processing/test_banded_normals.py",)
        for name in ("recording/banded_normals", "images/recorded_images")
    },
    "processing/recording/colour_normals.py": (
        "processing/test_banded_normals.py",
        "processing/test_colours.py",
        "processing/test_joint_colours.py",
    ),
    "processing/colour/channel_normals.py": (
        "processing/test_joint_colours.py",
        "processing/test_colours.py",
    ),
    "processing/colour/joint_colours.py": ("processing/test_joint_colours.py",),
    "processing/colour/specular.py": ("processing/test_specular.py",),
    "processing/surface/alternation.py": ("processing/test_alternation.py",),
    "processing/surface/anchors.py": ("processing/test_height_doubt.py",),
    "processing/surface/edge_certainty.py": ("processing/test_height_doubt.py",),
    "processing/surface/chord_rule.py": (
        "processing/test_chord_rule.py",
        "processing/test_extrapolation.py",
    ),
    "processing/surface/curl.py": ("processing/test_normal_curl.py",),
    "processing/surface/extrapolation.py": ("processing/test_extrapolation.py",),
    "processing/surface/height_errors.py": ("processing/test_height_doubt.py",),
    "processing/surface/integration.py": ("processing/test_integration.py",),
    "processing/surface/jump_kernels.py": (
        "processing/test_alternation.py",
        "processing/test_jumps.py",
    ),
    "processing/surface/jumps.py": ("processing/test_jumps.py",),
    "processing/surface/multigrid.py": ("processing/test_multigrid.py",),
    "processing/surface/prior.py": ("processing/test_height_doubt.py",),
    "processing/surface/prior_file.py": ("processing/test_prior_files.py",),
    "processing/meshes/solid.py": ("processing/test_mesh_simplification.py",),
    "processing/surface/thin_graphs.py": ("processing/test_multigrid.py",),
    "processing/surface/normal_turns.py": ("processing/test_turns.py",),
    f"{_DETAIL}/separation.py": ("processing/test_separation.py",),
    f"{_DETAIL}/detail_transfer.py": ("processing/test_transfer.py",),
    f"{_DETAIL}/placement.py": ("processing/test_transfer.py",),
    "processing/synthesis/hole_filling.py": ("processing/test_fill.py",),
    "processing/synthesis/hole_detail.py": ("processing/test_fill.py",),
    f"{_DETAIL}/rotation.py": ("processing/test_rotation.py",),
    f"{_DETAIL}/local_transfer.py": ("processing/test_local_transfer.py",),
    f"{_DETAIL}/properties.py": ("processing/test_properties.py",),
    "simulator/shapes/surface.py": (
        "simulator/test_surface_trace.py",
        "simulator/test_surface_shapes.py",
    ),
    "simulator/rendering/shade.py": (
        "simulator/test_shade.py",
        "simulator/test_render_closed_forms.py",
        "simulator/test_render_light_and_colour.py",
        "simulator/test_shadow_edges.py",
    ),
}  # fmt: skip
