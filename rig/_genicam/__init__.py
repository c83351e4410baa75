"""A GenICam camera, driven through harvesters."""
