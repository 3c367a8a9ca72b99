"""Built-in models: equations to identify and systems to simulate."""
