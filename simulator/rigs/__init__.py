"""Simulated rigs whose camera sees a rendered scene."""
