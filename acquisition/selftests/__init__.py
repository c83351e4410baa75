"""The self-test: checks with the camera that each LED works and is where the rig file states."""
