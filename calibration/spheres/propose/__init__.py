"""Where spheres may be: marked by a person, or found without masks."""
