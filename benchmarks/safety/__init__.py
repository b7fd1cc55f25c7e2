"""Studies of safety: hostile texts, damaged files and full disks, each over all commands."""
