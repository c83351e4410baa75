"""A GenICam camera, controlled through harvesters."""
