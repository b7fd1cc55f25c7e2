"""Readers that recognise the text layouts of recording programs and report them in notes."""
