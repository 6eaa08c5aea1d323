"""Studies: what the layer promises, what the source papers show, and what integrity is worth for learning."""
