"""True motion of vehicles, which is the input of all sensors, and scripted drives."""
