"""A plan carried out on a rig, into a session."""
