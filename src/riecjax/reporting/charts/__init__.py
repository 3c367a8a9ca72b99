"""Figures described once, and drawn twice: for print and for a page that zooms."""
