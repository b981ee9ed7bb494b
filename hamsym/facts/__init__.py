"""One description of each result, which texts, cards, reports, JSON and exports render."""
