"""Animations: a motion drawn frame by frame, as a page, a GIF or a film."""
