"""The commands (verbs) of `vttig`, one module each."""
