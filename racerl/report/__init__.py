"""The report: one page about finished runs, drawn from their files alone."""
