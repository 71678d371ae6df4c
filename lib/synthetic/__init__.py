"""Scenes of our own making, photographed by Mitsuba 3."""
