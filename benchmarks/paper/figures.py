"""The figures published in the paper, with which the tables compare."""

from __future__ import annotations

from collections.abc import Mapping

Row = tuple[float | None, ...]

MODELS = ("Circular", "Goethe", "Lizard", "Panno", "Woodcarving")

# Table "Property of the shape component": rotation angle and norms of R R' - I in a window.
SHAPE_SIMILARITY: Mapping[str, Row] = {
    "rotation angle, deg": (0.4950, 0.6049, 0.3249, 0.3391, 0.4678),
    "1-norm": (0.0109, 0.0133, 0.0066, 0.0074, 0.0100),
    "2-norm": (0.0086, 0.0106, 0.0057, 0.0059, 0.0082),
    "infinity-norm": (0.0109, 0.0133, 0.0066, 0.0074, 0.0100),
}

# Figure "Property of the extracted detail component" and its text.
SEPARABILITY: Mapping[str, Row] = {
    "detail's shape to z, deg": (0.96, 0.95, 1.47, 0.44, 0.47),
    "SSIM of detail and map, paper's protocol": (0.9566, 0.9531, 0.9882, 0.9557, 0.9737),
}

# Table "Evaluations of the detail idempotence": SSIM of an order with the first.
IDEMPOTENCE: Mapping[str, Row] = {
    "order 2": (0.9996, 0.9988, 0.9996, 0.9970, 0.9982),
    "order 3": (0.9990, 0.9977, 0.9992, 0.9936, 0.9961),
    "order 4": (0.9984, 0.9969, 0.9988, 0.9909, 0.9946),
}

# Chain over ten targets and back: only bounds are printed.
CHAIN_SHAPE_DEG_MAX = 2.08
CHAIN_DETAIL_DEG_MAX = 5.0
CHAIN_DETAIL_SSIM_MIN = 0.9980

# Figure "three properties": details of Circular and Walnut, exchanged and extracted again.
CROSS_EXCHANGE_DEG: Row = (4.13, 4.28)

# Table "transferred result between Circular and Bunny with different resolutions".
POINTS = (5010, 10106, 20441, 49532, 153145, 306491)
RESOLUTION: Mapping[str, Mapping[str, Row]] = {
    "shape error, deg": {
        "DSPL": (17.04, 16.62, 16.37, 16.00, None, None),
        "LAPL": (12.13, 11.07, 9.05, None, None, None),
        "normals": (4.97, 4.16, 3.48, 2.79, 2.42, 2.28),
    },
    "detail error, deg": {
        "DSPL": (16.02, 23.06, 32.15, 33.79, None, None),
        "LAPL": (14.65, 17.11, 21.78, None, None, None),
        "normals": (10.71, 10.93, 10.87, 10.90, 10.86, 10.86),
    },
    "detail SSIM": {
        "DSPL": (0.92, 0.83, 0.74, 0.72, None, None),
        "LAPL": (0.93, 0.90, 0.86, None, None, None),
        "normals": (0.9797, 0.9809, 0.9806, 0.9805, 0.9808, 0.9808),
    },
    "memory, MB": {
        "DSPL": (32.91, 67.70, 113.22, 745.59, None, None),
        "LAPL": (827.52, 3044.78, 12620.90, None, None, None),
        "normals": (5.08, 7.11, 10.62, 19.77, 53.50, 103.89),
    },
    "time, s": {
        "DSPL": (11.03, 41.62, 266.87, 2365.20, None, None),
        "LAPL": (20.93, 89.64, 383.56, None, None, None),
        "normals": (0.06, 0.19, 0.40, 0.57, 2.93, 3.82),
    },
}

# The abstract's "30 times of the input vertices, 6.5 % memory, 14.0 % running time": the normals'
# cell at the first number of points over LAPL's at the second.
HEADLINE_POINTS = (153145, 5010)
HEADLINE_MEMORY, HEADLINE_TIME = 0.065, 0.140

# Table "geometric detail transfer on DiLiGenT", source Flower.
DILIGENT_TARGETS = (
    "ball", "cat", "pot1", "bear", "pot2", "buddha", "goblet", "reading", "cow", "harvest",
)  # fmt: skip
DILIGENT: Mapping[str, Mapping[str, Row]] = {
    "shape error, deg": {
        "DSPL": (4.10, 5.93, 8.83, 7.13, 3.18, 4.90, 4.82, 9.43, 4.04, 2.51),
        "LAPL": (1.73, 2.22, 2.85, 3.17, 4.37, 6.49, 3.39, 3.02, 2.25, 6.10),
        "normals": (1.83, 2.02, 2.49, 1.96, 2.26, 2.54, 2.90, 2.09, 1.90, 2.43),
    },
    "shape SSIM": {
        "DSPL": (
            0.9895, 0.9944, 0.9868, 0.9827, 0.9979, 0.9950, 0.9972, 0.9744, 0.9945, 0.9992,
        ),
        "LAPL": (
            0.9983, 0.9990, 0.9984, 0.9956, 0.9959, 0.9916, 0.9987, 0.9979, 0.9988, 0.9946,
        ),
        "normals": (
            0.9990, 0.9995, 0.9995, 0.9994, 0.9995, 0.9994, 0.9994, 0.9994, 0.9995, 0.9994,
        ),
    },
    "detail error, deg": {
        "DSPL": (16.15, 19.67, 24.31, 19.91, 19.57, 26.17, 24.63, 23.73, 16.90, 20.50),
        "LAPL": (13.90, 17.53, 18.73, 15.19, 18.14, 24.71, 20.03, 18.03, 15.13, 21.73),
        "normals": (1.43, 4.13, 6.83, 3.55, 6.17, 13.02, 5.69, 5.67, 3.57, 10.63),
    },
    "detail SSIM": {
        "DSPL": (
            0.9088, 0.9205, 0.9307, 0.8959, 0.9443, 0.9158, 0.9531, 0.8826, 0.9265, 0.9291,
        ),
        "LAPL": (
            0.9385, 0.9445, 0.9603, 0.9438, 0.9491, 0.9269, 0.9665, 0.9369, 0.9513, 0.9251,
        ),
        "normals": (
            0.9994, 0.9964, 0.9933, 0.9966, 0.9933, 0.9805, 0.9966, 0.9933, 0.9971, 0.9848,
        ),
    },
    "memory, MB": {
        "DSPL": (305.24, 305.23, 310.66, 301.87, 304.72, 308.43, 303.31, 311.93, 304.59, 311.30),
        "LAPL": (
            12183.22, 11616.61, 11694.25, 11587.38, 12276.66, 11988.65, 12760.16, 11457.79,
            11853.22, 10910.99,
        ),
        "normals": (17.66, 18.75, 21.76, 17.64, 19.91, 19.23, 25.82, 17.63, 17.39, 20.10),
    },
    "time, s": {
        "DSPL": (5.26, 5.05, 4.88, 4.60, 4.64, 4.87, 4.61, 4.83, 4.77, 4.44),
        "LAPL": (
            696.67, 658.30, 688.34, 586.96, 675.27, 819.87, 676.72, 706.23, 647.91, 733.78,
        ),
        "normals": (0.50, 0.48, 0.52, 0.40, 0.44, 0.50, 0.59, 0.42, 0.47, 0.50),
    },
}  # fmt: skip

# Figure "performance evaluation in terms of the height profile": curves, no numbers.
HEIGHT_PROFILES = ("Lizard", "Textile")

# Local transfer: source's face onto target, error of the region's detail.
LOCAL_DEG: Mapping[str, float] = {
    "Goethe onto Venus": 1.36,
    "Cat onto Bear": 3.23,
    "Goethe onto Buddha": 3.11,
}
LOCAL_SSIM: Mapping[str, float] = {"Goethe onto Venus": 0.9898}

# Synthesis on a target: time in s and memory in MB.
SYNTHESIS: Mapping[str, Row] = {"1.67 million vertices": (11.88, 857.0)}

# Synthesis: SSIM of the detail, and for Lizard on Max Planck time in s and memory in MB.
SYNTHESIS_SYSTEMS: Mapping[str, Row] = {
    "Lizard on Max Planck, DGTS": (0.7740, 233.0, 14216.0),
    "Lizard on Max Planck, the paper's": (0.9901, 11.88, 857.0),
    "Textile on Cat, DGTS": (0.7180, None, None),
    "Textile on Cat, the paper's": (0.9903, None, None),
}

# Super-resolution, scale 4: error of the normals, and its SSIM protocol.
SUPERRES_COLUMNS = ("Panno, deg", "Panno, SSIM", "Fish, deg", "Fish, SSIM")
SUPERRES: Mapping[str, Row] = {
    "PU-Net": (24.39, 0.8242, 25.96, 0.7444),
    "RDN on normals": (6.61, 0.9782, 4.78, 0.9757),
    "RDN on details": (4.92, 0.9905, 3.28, 0.9869),
}
