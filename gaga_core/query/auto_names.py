"""Names for groups from a list of nouns, by the index; unsure ones stay without.

The similarity of a group to all nouns is made a distribution; a noun must have enough of it, and
clearly more than the next one. What a noun is like in general is taken off first: some nouns are
near to every crop.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray
from gaga_core.query.index import GroupIndex, TextVectors

# --- Nouns that groups are named with: objects of homes, shops, streets and gardens.


_TEXT = """
table, chair, armchair, sofa, stool, bench, bed, pillow, blanket, mattress, desk, shelf,
bookshelf, cupboard, cabinet, drawer, wardrobe, dresser, nightstand, rug, carpet, curtain, window
blind, mirror, picture frame, painting, poster, wall clock, alarm clock, lamp, table lamp, floor
lamp, ceiling lamp, light bulb, candle, vase, plant pot, houseplant, flower, bouquet, cactus,
fireplace, radiator, fan, door, door handle, window, wall, floor, ceiling, staircase, column,
tile, brick, light switch, power socket, cable, extension cord, coat rack, clothes hanger, trash
can, laundry basket, bucket, broom, mop, vacuum cleaner, ironing board, iron, ladder, toolbox,
plate, bowl, cup, mug, glass, wine glass, bottle, water bottle, wine bottle, jar, pitcher, teapot,
kettle, coffee maker, thermos, tray, fork, knife, spoon, chopsticks, ladle, spatula, whisk,
cutting board, frying pan, cooking pot, saucepan, lid, colander, grater, can opener, corkscrew,
toaster, microwave, oven, stove, refrigerator, dishwasher, sink, faucet, sponge, dish soap, paper
towel, napkin, tablecloth, salt shaker, pepper mill, spray bottle, detergent bottle, soup can, tin
can, soda can, cereal box, cracker box, cardboard box, milk carton, egg carton, mustard bottle,
ketchup bottle, sugar box, coffee can, bag of chips, plastic bag, paper bag, apple, banana,
orange, lemon, lime, pear, peach, plum, strawberry, grapes, pineapple, watermelon, melon, kiwi,
mango, coconut, cherry, tomato, potato, onion, garlic, carrot, cucumber, bell pepper, broccoli,
cauliflower, cabbage, lettuce, corn, mushroom, pumpkin, eggplant, avocado, egg, bread, sandwich,
burger, pizza, noodles, sushi, cake, cupcake, doughnut, cookie, croissant, waffle, chocolate bar,
candy, ice cream, cheese, sausage, fish, meat, salad, bowl of ramen, cup of coffee, cup of tea,
laptop, computer monitor, keyboard, computer mouse, mouse pad, printer, speaker, headphones,
microphone, webcam, camera, camera tripod, mobile phone, tablet computer, television, remote
control, game controller, router, hard drive, battery, charger, calculator, wristwatch, book,
notebook, magazine, newspaper, sheet of paper, envelope, pen, pencil, marker, crayon, eraser,
ruler, scissors, stapler, tape dispenser, roll of tape, glue stick, paper clip, folder, binder,
sticky note, globe, map, whiteboard, desk organizer, hammer, screwdriver, wrench, pliers, power
drill, saw, axe, clamp, tape measure, paint brush, paint can, screw, nail, rope, chain, padlock,
key, flashlight, spray can, shovel, rake, watering can, wheelbarrow, garden hose, flower pot, lawn
mower, toy car, toy train, toy airplane, toy block, Lego bricks, doll, teddy bear, stuffed animal,
action figure, rubber duck, puzzle, Rubik's cube, dice, chess board, playing cards, balloon, kite,
ball, tennis ball, soccer ball, basketball, baseball, golf ball, volleyball, baseball bat, tennis
racket, skateboard, skis, dumbbell, yoga mat, helmet, bicycle, scooter, backpack, handbag,
suitcase, wallet, purse, umbrella, hat, cap, sunglasses, glasses, scarf, glove, sock, shoe, boot,
sandal, slipper, shirt, T-shirt, jacket, coat, trousers, dress, belt, tie, towel, soap, shampoo,
toothbrush, toothpaste, hairbrush, comb, hair dryer, razor, toilet, toilet paper, bathtub, shower,
tissue box, perfume bottle, lipstick, medicine bottle, first aid kit, guitar, piano, violin, drum,
trumpet, flute, car, truck, bus, motorcycle, train, boat, airplane, traffic light, traffic cone,
street sign, stop sign, street lamp, fire hydrant, mailbox, parking meter, fence, gate, wall of
stones, bridge, house, building, tower, roof, chimney, balcony, awning, statue, fountain,
monument, tent, picnic table, park bench, swing, slide, grill, parasol, tree, tree stump, bush,
hedge, grass, lawn, flower bed, leaf, branch, log, rock, stone, pebble, sand, soil, pavement,
road, path, water, pond, river, sky, mountain, snow, person, dog, cat, bird, horse, cow, sheep,
rabbit, fox, bear, elephant, dinosaur, duck, chicken, mannequin, head of a statue, figurine,
trophy, gift box, ribbon, wreath, Christmas tree, flag, basket, wicker basket, wooden crate,
barrel, pallet, plastic container, storage box, jewelry box, piggy bank, incense burner, lantern,
birdcage, fish tank, telescope, microscope, scale, thermometer, fire extinguisher, vending
machine, cash register, shopping cart, wheel, tire, engine
"""
NOUNS: tuple[str, ...] = tuple(
    dict.fromkeys(" ".join(noun.split()) for noun in _TEXT.split(",") if noun.strip())
)


_MANY = 8  # groups of which a mean says something about the noun, not about them


@dataclass(frozen=True)
class NameConfig:
    """When a group is named."""

    sharpness: float = 100.0  # of the distribution over nouns, per unit of cosine (CLIP's own)
    least: float = 0.30  # share that the best noun must have
    margin: float = 1.6  # times the share of the next
    own: float = 0.5  # how much of a noun's mean over all groups is taken off

    def __post_init__(self) -> None:
        if not (0 < self.least < 1 and self.margin >= 1 and 0 <= self.own <= 1):
            raise ValueError(f"names: out of range: {self}")


def suggest_names(
    index: GroupIndex,
    nouns: Sequence[str],
    vectors: FloatArray,
    *,
    taken: Mapping[int, str] | None = None,
    config: NameConfig | None = None,
) -> dict[int, str]:
    """Names by group for those that are sure; ``taken`` are names that people gave, kept as is.

    ``vectors`` (W, D) belong to ``nouns``. Groups of one noun are distinguished by a number: "mug",
    "mug 2".
    """
    config = config or NameConfig()
    taken = taken or {}
    best, sure = _best_nouns(index.vectors, vectors, config)
    used = {name.casefold() for name in taken.values()}
    names: dict[int, str] = {}
    for group, noun, certain in zip(index.groups, best, sure, strict=True):
        if not certain or int(group) in taken or group <= 0:
            continue
        name, k = nouns[noun], 1
        while name.casefold() in used:
            k += 1
            name = f"{nouns[noun]} {k}"
        used.add(name.casefold())
        names[int(group)] = name
    return names


def name_by_nouns(
    index: GroupIndex, texts: TextVectors, *, taken: Mapping[int, str] | None = None
) -> dict[int, str]:
    """`suggest_names` with our own list; the nouns' vectors are made once and kept by ``texts``."""
    return suggest_names(index, NOUNS, texts.nouns(NOUNS), taken=taken)


def _best_nouns(
    groups: FloatArray, nouns: FloatArray, config: NameConfig
) -> tuple[list[int], list[bool]]:
    if len(groups) == 0 or len(nouns) == 0:
        return [0] * len(groups), [False] * len(groups)
    likeness: DoubleArray = (groups @ nouns.T).astype(np.float64)
    seen = np.abs(groups).max(axis=1) > 0
    if seen.sum() >= _MANY:
        mean = likeness[seen].mean(axis=0)
        likeness = likeness - config.own * (mean - mean.mean())
    weight = np.exp(config.sharpness * (likeness - likeness.max(axis=1, keepdims=True)))
    share = np.sort(weight / weight.sum(axis=1, keepdims=True), axis=1)
    second = share[:, -2] if share.shape[1] > 1 else np.zeros(len(share))
    sure = seen & (share[:, -1] >= config.least) & (share[:, -1] >= config.margin * second)
    return likeness.argmax(axis=1).tolist(), sure.tolist()
