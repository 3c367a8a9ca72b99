from .command import Given as Given
from .command import settings_command as settings_command
from .progress import Progress as Progress
