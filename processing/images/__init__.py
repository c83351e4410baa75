"""The images of a recording: which are used, where the object is, and how they see it."""
