"""YAML documents in which every value knows its place, so that an error can name file, line, column and field.

And how any file is read, of bounded size, and written, whole or not at all.
"""

from localiser.documents.document import Document, Place, dump, field_name, is_name, plain_name, shown
from localiser.documents.files import MAX_DOCUMENT_BYTES, open_regular, read_bytes, read_text, require_regular, text_of
from localiser.documents.models import Schema, nearest, read_model, validate
from localiser.documents.output import draft_beside, drafted, output_errors, remove, write_all, write_bytes, write_text
from localiser.documents.parse import load, parse
