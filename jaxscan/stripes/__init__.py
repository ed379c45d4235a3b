"""Frames to stripe centres."""
