"""Commands (verbs) on gears and their teeth: measures for a workshop, surfaces, and contact."""
