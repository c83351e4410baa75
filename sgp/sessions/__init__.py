"""Messages, summaries and contact sheets of the capture commands."""
