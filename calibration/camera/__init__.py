"""The camera: calibration boards, their corners in images, and intrinsics from several views."""
