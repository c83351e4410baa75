"""What functions report to people: notices, progress, and the wording of messages."""
