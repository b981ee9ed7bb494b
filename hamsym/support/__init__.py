"""Files, locks, progress and checks of arguments."""
