"""Tables, plots and texts of measurements."""
