from .catalogue import find_model as find_model
