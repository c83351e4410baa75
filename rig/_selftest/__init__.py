"""Which LEDs burn, and which are where the rig file says, by what the camera sees."""
