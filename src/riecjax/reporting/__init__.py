"""Results for people and scripts: tables, JSON documents, figures, HTML."""
