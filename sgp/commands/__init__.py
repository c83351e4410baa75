"""The commands: each function takes the options of one command and returns a `Result`."""
