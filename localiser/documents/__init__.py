"""YAML documents in which every value knows its place, so that an error can name file, line, column and field.

How any file is read, of bounded size, and written, whole or not at all. And typed data as bytes.
"""

from localiser.documents.document import (
    Document,
    Place,
    Schema,
    dump,
    field_name,
    is_name,
    load,
    nearest,
    parse,
    plain_name,
    shown,
    validate,
)
from localiser.documents.files import (
    MAX_DOCUMENT_BYTES,
    draft_beside,
    drafted,
    open_regular,
    output_errors,
    read_bytes,
    read_text,
    remove,
    require_regular,
    text_of,
    write_all,
    write_bytes,
    write_text,
)
from localiser.documents.typed_data import decode, encode, fingerprint
