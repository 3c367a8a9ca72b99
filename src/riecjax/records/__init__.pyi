from .preparation import split_at as split_at
from .preparation import upsample as upsample
from .quality import check_signals as check_signals
from .reading.read import read_channels as read_channels
from .record import stack_records as stack_records
from .recording import ReadingSettings as ReadingSettings
