"""Positioning services: sources of an absolute position ahead of mode selection."""
