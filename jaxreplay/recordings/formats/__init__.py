"""Formats of recordings, one file for each: a file becomes a :class:`recording.Recording`."""
