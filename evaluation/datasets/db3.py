"""ROS 2 bags in SQLite files (.db3): the default of ROS 2 up to Humble."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from revisit.core.errors import MalformedBody
from revisit.evaluation.datasets.bag_message import Message, Place

_MAGIC = b"SQLite format 3\0"
_MESSAGES = (
    "SELECT messages.id, topics.name, topics.type, messages.data FROM messages JOIN topics ON "
    "topics.id = messages.topic_id WHERE topics.serialization_format = 'cdr' AND topics.type IN ({}) "
    "ORDER BY messages.timestamp, messages.id"
)


class Db3File:
    """As `McapFile`: read in one pass, then message by message. A message's place is its row."""

    def __init__(self, file: Path, types: tuple[str, ...]) -> None:
        """Only messages of the given types are read. Raises MalformedBody where the file is no SQLite database."""
        self.topics: dict[str, str] = {}
        self.cut = ""
        self.damaged = 0
        self._file, self._types = file, types
        with file.open("rb") as stream:
            if stream.read(len(_MAGIC)) != _MAGIC:
                raise MalformedBody(f"{file.name} is no SQLite file")

    def messages(self) -> Iterator[Message]:
        """All CDR messages of the wanted types by time. Raises MalformedBody."""
        query = _MESSAGES.format(", ".join("?" * len(self._types)))
        try:
            with closing(self._open()) as connection:
                self.topics.update(connection.execute("SELECT name, type FROM topics"))
                for row, topic, kind, data in connection.execute(query, self._types):
                    yield Message(topic, kind, bytes(data), Place(None, row, len(data)))
        except sqlite3.Error as error:
            raise MalformedBody(
                f"{self._file.name} is no readable bag: {error}. SQLite may save what is left of it: "
                f"sqlite3 {self._file.name} .recover | sqlite3 saved.db3"
            ) from error

    def data(self, place: Place) -> bytes:
        """The bytes of a message."""
        with closing(self._open()) as connection:
            (data,) = connection.execute("SELECT data FROM messages WHERE id = ?", (place.offset,)).fetchone()
        return bytes(data)

    def _open(self) -> sqlite3.Connection:
        return sqlite3.connect(f"{self._file.resolve().as_uri()}?mode=ro", uri=True)
