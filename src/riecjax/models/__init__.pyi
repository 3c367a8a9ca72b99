from .model import as_model as as_model
