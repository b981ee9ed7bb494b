"""Work in threads, in processes and on clusters, side by side."""
