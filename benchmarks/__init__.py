"""Speed and accuracy studies; see README.md. A package of its own, so that no other hides it."""
