"""The front door: commands, plots, reports and the demo. Everything a person sees."""

__version__ = "0.1.0"
