"""What a diagnosis says, one statement a module: its numbers, and the words for them. Report, terminal, notebook and page lay them out."""
