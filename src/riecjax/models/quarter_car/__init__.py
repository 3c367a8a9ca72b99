"""The quarter car of the paper: source model, identification model, and its equations."""
