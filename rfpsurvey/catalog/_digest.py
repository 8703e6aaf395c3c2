"""Compute a digest of columns in Parquet files from the stored bytes."""

from pathlib import Path


def add_stored_columns(digest, path: Path, names: list[str]) -> None:
    """Update a ``hashlib`` digest with the types and the stored bytes of the given columns of a Parquet file."""
    from pyarrow import parquet

    about = parquet.read_metadata(path)
    columns = [(about.schema.column(k).path, k) for k in range(about.num_columns)]
    columns = sorted((name, k) for name, k in columns if name.split(".")[0] in names)
    with path.open("rb") as file:
        for name, k in columns:
            kind = about.schema.column(k)
            digest.update(f"{name} {kind.physical_type} {kind.logical_type}".encode())
            for group in range(about.num_row_groups):
                chunk = about.row_group(group).column(k)
                begin = chunk.data_page_offset
                if chunk.has_dictionary_page:
                    begin = min(begin, chunk.dictionary_page_offset or begin)
                digest.update(f"{chunk.compression} {chunk.num_values}".encode())
                file.seek(begin)
                digest.update(file.read(chunk.total_compressed_size))
