from .assess import assess_summary as assess_summary
from .verdict import Verdict as Verdict
