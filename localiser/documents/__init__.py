"""YAML documents in which every value knows its place, so that an error can name file, line, column and field."""

from localiser.documents.document import Document, Key, Place, dump, field_name, shown
from localiser.documents.files import MAX_DOCUMENT_BYTES, read_bytes, read_text
from localiser.documents.models import Schema, nearest, read_model, validate
from localiser.documents.parse import load, parse
