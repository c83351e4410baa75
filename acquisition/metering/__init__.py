"""Metering: exposures chosen from trial frames."""
