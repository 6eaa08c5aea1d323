"""The context-aware monitor of S5: position, speed and map are checked one after another."""
