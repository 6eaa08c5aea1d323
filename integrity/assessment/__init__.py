"""Assessment of errors, protection levels, alerts and availability against the truth."""
