from .comparison import Comparison as Comparison
from .identification import identification_document as identification_document
from .identification_page import write_report as write_report
from .result_files import Results as Results
