"""The core modules, and the test files that must detect a fault in each, fastest first."""

from __future__ import annotations

_SPHERES = "calibration/_spheres"
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
_DETAIL = "processing/_detail"

TARGETS: dict[str, tuple[str, ...]] = {
    "acquisition/_engine/rejection.py": (
        "acquisition/test_references.py",
        "acquisition/test_rejection.py",
        "acquisition/test_short_brackets.py",
    ),
    "acquisition/_engine/agenda.py": (
        "acquisition/test_agenda.py",
        "acquisition/test_judging_order.py",
    ),
    "acquisition/_engine/carry_out.py": (
        "acquisition/test_engine.py",
        "acquisition/test_engine_ctrl_c.py",
        "acquisition/test_engine_lost_shots.py",
        "acquisition/test_engine_refusals.py",
        "acquisition/test_engine_sequences.py",
        "acquisition/test_engine_slow_disk.py",
        "acquisition/test_engine_disk.py",
        "acquisition/test_set_aside.py",
    ),
    "acquisition/_session/journal.py": ("acquisition/test_journal.py", _LINES),
    "acquisition/_session/recorded.py": ("acquisition/test_recorded.py", *_SESSION),
    "acquisition/_session/open_shots.py": (
        "acquisition/test_recorded.py",
        "acquisition/test_resume.py",
        "acquisition/test_resume_left_out.py",
        "acquisition/test_resume_refusals.py",
    ),
    "acquisition/_session/verify.py": _SESSION,
    "rig/_shooting/alive.py": (_VALUES,),
    "rig/_shooting/dark.py": ("rig/test_dark.py", "rig/test_rig_signals.py"),
    "rig/_shooting/shot_times.py": (_VALUES,),
    "rig/_shooting/frame_proof.py": (_VALUES, _BY_CLOCK, "rig/test_rig_shoot.py"),
    "rig/_shooting/sequence.py": (_VALUES, _BY_CLOCK, "rig/test_rig_sequence.py"),
    "rig/_shooting/shooting.py": (_VALUES, _BY_CLOCK, "rig/test_rig_shoot.py"),
    "rig/_shooting/shot.py": (_VALUES,),
    "rig/_board/protocol.py": ("rig/test_protocol_lines.py",),
    "rig/_board/replies.py": ("rig/test_board_replies.py",),
    "calibration/_radiance/developer.py": (
        "calibration/test_radiance_limits.py",
        "calibration/test_radiance.py",
    ),
    "calibration/_radiance/linear_stack.py": (
        "calibration/test_radiance_limits.py",
        "calibration/test_radiance.py",
        "calibration/test_raw_stack.py",
    ),
    "calibration/_flat/combine.py": ("calibration/test_flat.py",),
    "calibration/_flat/card.py": ("calibration/test_flat.py",),
    **{
        f"calibration/_sensor/{name}.py": ("calibration/test_sensor.py",)
        for name in (
            "calibrate",
            "dark_frames",
            "photon_transfer",
            "recorded_series",
            "series_points",
        )
    },
    f"{_SPHERES}/calibrate.py": _WHOLE_CALIBRATION,
    f"{_SPHERES}/cone.py": ("calibration/test_robust_fits.py", "calibration/test_outline.py"),
    f"{_SPHERES}/ellipse.py": ("calibration/test_robust_fits.py", "calibration/test_outline.py"),
    f"{_SPHERES}/edge_search.py": (_SEARCH, _PARTS),
    f"{_SPHERES}/average_directions.py": ("calibration/test_light_uncertainty.py",),
    f"{_SPHERES}/highlights.py": ("calibration/test_highlights.py", _PARTS),
    f"{_SPHERES}/input_tests.py": ("calibration/test_input_tests.py",),
    f"{_SPHERES}/joint_refinement.py": (
        "calibration/test_light_positions.py",
        "calibration/test_light_uncertainty.py",
    ),
    f"{_SPHERES}/light_positions.py": ("calibration/test_light_positions.py", _PARTS),
    f"{_SPHERES}/limb.py": ("calibration/test_outline.py",),
    f"{_SPHERES}/limb_fit.py": ("calibration/test_limb_fit.py",),
    f"{_SPHERES}/marked.py": (_MARKS, _PARTS),
    f"{_SPHERES}/outline.py": (*_OUTLINE, _PARTS),
    f"{_SPHERES}/outline_noise.py": ("calibration/test_light_uncertainty.py",),
    f"{_SPHERES}/placed.py": (_PARTS, "calibration/test_light_positions.py"),
    f"{_SPHERES}/reflection.py": (
        "calibration/test_reflection.py",
        "calibration/test_light_positions.py",
    ),
    f"{_SPHERES}/robust.py": ("calibration/test_robust_fits.py",),
    f"{_SPHERES}/search.py": (_SEARCH, _PARTS),
    f"{_SPHERES}/sphere_calibration.py": (_PARTS,),
    f"{_SPHERES}/sphere_image.py": (_PARTS,),
    f"{_SPHERES}/spot.py": ("calibration/test_spot.py", "calibration/test_highlights.py"),
    **{
        f"processing/_stereo/{name}.py": (
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
        f"processing/_stereo/{name}.py": (
            "processing/test_photometric_best.py",
            "processing/test_photometric_stereo.py",
        )
        for name in ("best", "reflectance_fit")
    },
    "processing/_stereo/pixel_algebra.py": (
        "processing/test_photometric_stereo.py",
        "processing/test_photometric_near.py",
        "processing/test_photometric_noise.py",
    ),
    **{
        f"processing/_stereo/{name}.py": ("processing/test_tile_least_squares.py",)
        for name in ("frames", "tile_kernels", "tile_least_squares")
    },
    "processing/_stereo/image_noise.py": (
        "processing/test_image_noise.py",
        "processing/test_photometric_noise.py",
    ),
    "processing/_stereo/frame_normals.py": ("processing/test_frame_normals.py",),
    "processing/_stereo/photometric_stereo.py": (
        "processing/test_photometric_stereo.py",
        "processing/test_photometric_near.py",
    ),
    "processing/_curvature/curvature.py": ("processing/test_curvature.py",),
    **{
        f"processing/_uncertainty/{name}.py": ("processing/test_normal_uncertainty.py",)
        for name in (
            "judged_samples",
            "light_table",
            "pixel_variances",
            "reference",
            "reflectance_left",
            "reference_solver",
            "tangents",
        )
    },
    "processing/_uncertainty/tile_reference.py": (
        "processing/test_tile_reference.py",
        "processing/test_normal_uncertainty.py",
    ),
    "processing/_uncertainty/pixel_variances.py": (
        "processing/test_model_error.py",
        "processing/test_normal_uncertainty.py",
    ),
    **{
        f"processing/_reconstruction/{name}.py": ("processing/test_banded_normals.py",)
        for name in ("banded_normals", "recorded_images")
    },
    "processing/_reconstruction/colour_normals.py": (
        "processing/test_banded_normals.py",
        "processing/test_colours.py",
        "processing/test_joint_colours.py",
    ),
    "processing/_reconstruction/colours.py": (
        "processing/test_joint_colours.py",
        "processing/test_colours.py",
    ),
    "processing/_reconstruction/joint_colours.py": ("processing/test_joint_colours.py",),
    "processing/_reconstruction/specular.py": ("processing/test_specular.py",),
    "processing/_surface/alternation.py": ("processing/test_alternation.py",),
    "processing/_surface/anchors.py": ("processing/test_height_doubt.py",),
    "processing/_surface/certainty.py": ("processing/test_height_doubt.py",),
    "processing/_surface/chord_rule.py": (
        "processing/test_chord_rule.py",
        "processing/test_extrapolation.py",
    ),
    "processing/_surface/curl.py": ("processing/test_normal_curl.py",),
    "processing/_surface/extrapolation.py": ("processing/test_extrapolation.py",),
    "processing/_surface/height_errors.py": ("processing/test_height_doubt.py",),
    "processing/_surface/integration.py": ("processing/test_integration.py",),
    "processing/_surface/jump_kernels.py": (
        "processing/test_alternation.py",
        "processing/test_jumps.py",
    ),
    "processing/_surface/jumps.py": ("processing/test_jumps.py",),
    "processing/_surface/multigrid.py": ("processing/test_multigrid.py",),
    "processing/_surface/prior.py": ("processing/test_height_doubt.py",),
    "processing/_surface/prior_file.py": ("processing/test_prior_files.py",),
    "processing/_surface/solid.py": ("processing/test_mesh_simplification.py",),
    "processing/_surface/thin_graphs.py": ("processing/test_multigrid.py",),
    "processing/_surface/turns.py": ("processing/test_turns.py",),
    f"{_DETAIL}/separation.py": ("processing/test_separation.py",),
    f"{_DETAIL}/transfer.py": ("processing/test_transfer.py",),
    f"{_DETAIL}/placement.py": ("processing/test_transfer.py",),
    "processing/_fill/fill.py": ("processing/test_fill.py",),
    "processing/_fill/quilted.py": ("processing/test_fill.py",),
    f"{_DETAIL}/rotation.py": ("processing/test_rotation.py",),
    f"{_DETAIL}/local_transfer.py": ("processing/test_local_transfer.py",),
    f"{_DETAIL}/properties.py": ("processing/test_properties.py",),
    "simulator/_shapes/surface.py": (
        "simulator/test_surface_trace.py",
        "simulator/test_surface_shapes.py",
    ),
    "simulator/_render/shade.py": (
        "simulator/test_shade.py",
        "simulator/test_render_closed_forms.py",
        "simulator/test_render_light_and_colour.py",
        "simulator/test_shadow_edges.py",
    ),
}  # fmt: skip
