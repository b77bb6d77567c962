"""Nouns that groups are named with: what stands about in homes, shops, streets and gardens."""

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
