"""Runnable claims: what the documentation says in numbers is measured here."""
