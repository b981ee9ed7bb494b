"""The kernel: a library in C for the loops of solving and proving, the same bits everywhere."""
