"""Normal maps and masks, their files, and their comparison."""
