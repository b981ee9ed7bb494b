"""Files, locks, progress bars, checks of arguments and of data."""
