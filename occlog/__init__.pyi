from occlog.api import *

__version__: str
