"""The types of the fields of edit scripts: what msgspec checks while it reads one.

Descriptions end the sentence "field .. must be ..". A union of a bounded number and a tuple of
fixed length crashes msgspec 0.22; within unions, tuples of any length have bounds instead.
"""

from typing import Annotated, Literal

from msgspec import Meta

_LARGEST = 1e18  # products of three stay finite in float64, and values in float32
Number = Annotated[
    float, Meta(ge=-_LARGEST, le=_LARGEST, description=f"a number up to {_LARGEST:g}")
]
Positive = Annotated[float, Meta(gt=0, le=_LARGEST, description="a number above 0")]
Share = Annotated[float, Meta(ge=0, le=1, description="a number between 0 and 1")]
SignedShare = Annotated[float, Meta(ge=-1, le=1, description="a number between -1 and 1")]
Count = Annotated[int, Meta(ge=1, description="a whole number of at least 1")]
Flag = Annotated[bool, Meta(description="true or false")]
Name = Annotated[str, Meta(max_length=200, description="a text of at most 200 characters")]
FilePath = Annotated[str, Meta(max_length=4096, description="the path of a file")]
Digest = Annotated[
    str, Meta(pattern="^([0-9a-fA-F]{64})?$", description="64 hexadecimal digits (SHA-256)")
]
How = Annotated[  # a way to change the selection
    Literal["set", "add", "remove", "intersect"], Meta(description="set, add, remove or intersect")
]
LabelSource = Annotated[Literal["votes", "identities"], Meta(description="votes or identities")]
Axis = Annotated[Literal["x", "y", "z"], Meta(description="x, y or z")]
Vector = Annotated[
    tuple[Number, Number, Number], Meta(description=f"a list of 3 numbers up to {_LARGEST:g}")
]
Color = Annotated[  # red, green, blue
    tuple[Share, Share, Share], Meta(description="a list of 3 numbers between 0 and 1")
]
_Three = Annotated[tuple[Positive, ...], Meta(min_length=3, max_length=3)]
Factors = Annotated[  # of all axes, or of each
    Positive | _Three, Meta(description="above 0: one number, or a list of 3")
]
_Row = tuple[Number, Number, Number, Number]
Matrix = Annotated[tuple[_Row, _Row, _Row], Meta(description="3 rows of 4 numbers")]
Points = Annotated[tuple[Vector, Vector, Vector], Meta(description="3 points of 3 numbers")]
Ends = Annotated[tuple[Vector, Vector], Meta(description="2 points of 3 numbers")]
OneGroup = Annotated[int | str, Meta(description="a group id or name")]
Groups = Annotated[
    tuple[int | str, ...], Meta(min_length=1, description="a list of group ids or names")
]
