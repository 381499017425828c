"""Files in object stores and on web servers, by fsspec: found, fetched into a bounded cache, and written."""
