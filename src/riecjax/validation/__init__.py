"""How well a simulated model predicts a record."""
