"""The method "features": collocation with random sine features in windows, to a tolerance."""
