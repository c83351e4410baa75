"""Sheets of pictures and their panels."""
