"""Images of other programs and cameras made into sessions."""
