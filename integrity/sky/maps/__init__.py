"""Real street maps: streets, buildings and trees of OpenStreetMap as obstacles and as roads."""
