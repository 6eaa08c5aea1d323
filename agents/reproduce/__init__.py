"""Studies that reproduce what the source papers show, with one documented parameter set each."""
