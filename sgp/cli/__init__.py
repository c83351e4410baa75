"""The terminal: start and exit, options, help, progress, and lines that fit."""
