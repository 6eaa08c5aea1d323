"""What every other part stands on: configuration, errors, random streams, compiled code, frames."""
