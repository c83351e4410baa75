"""What the capture commands say and draw."""
