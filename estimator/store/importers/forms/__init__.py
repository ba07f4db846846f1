"""Files of readings as spreadsheets, instruments and scripts leave them: how they are read, as a proposal and as a recipe."""
