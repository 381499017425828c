"""Reports of a command: notes and progress on standard error, summaries on standard output, exit codes.

Independent of options and of click, so that every package may use it.
"""

from occlog.console.notes import note as note
from occlog.console.notes import note_findings as note_findings
from occlog.console.notes import note_losses as note_losses
from occlog.console.notes import notes_kept as notes_kept
from occlog.console.notes import progress as progress
from occlog.console.summary import echo_summary as echo_summary
from occlog.console.summary import finish as finish
from occlog.console.summary import lines_of as lines_of
from occlog.console.summary import strict_code as strict_code
