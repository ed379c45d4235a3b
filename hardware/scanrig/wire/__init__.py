"""Bytes and messages between host and controller."""
