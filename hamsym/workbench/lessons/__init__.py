"""Lessons: a system as one page that computes and draws its motion in the reader's browser."""
