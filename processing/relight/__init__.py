"""Images as functions of the direction of their light, and the files in which viewers read them."""
