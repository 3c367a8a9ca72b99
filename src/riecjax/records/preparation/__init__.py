"""Steps between a raw recording and the record that an equation reads."""
