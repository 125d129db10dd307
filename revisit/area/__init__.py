"""Search and localise in the file of a map, without a service: `from revisit.area import AreaMap`."""

from revisit.area.conversation import AreaConversation
from revisit.area.offline_map import AreaMap

__all__ = ["AreaConversation", "AreaMap"]
