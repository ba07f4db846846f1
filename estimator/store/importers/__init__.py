"""From files of others to sessions: the readings CSV, and maps of public repositories."""
