"""The command line `vttig`; each of its commands (verbs) has one module in `verbs`."""
