"""Initial-value problems and ensembles, checked, with what is known of their motion."""
