"""Models, loops, references and assertions that several test files share."""
