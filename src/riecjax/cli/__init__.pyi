from .command import Given as Given
from .command import settings_command as settings_command
