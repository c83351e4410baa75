"""One module per command; each function takes options and returns a `Result`."""
