"""Results for people and programs: the verdict, the terminal summary, report.json and report.html. Pure functions."""
