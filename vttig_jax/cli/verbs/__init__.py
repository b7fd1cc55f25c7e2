"""The verbs of `vttig`, one module each."""
