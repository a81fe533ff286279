//! What joints are named after.

/// A body part, or part of a thing, that a word of a joint's name means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    Head,
    Spine,
    Arm,
    Hand,
    Finger,
    Leg,
    Foot,
    Tail,
    Wing,
    Feather,
    Fin,
    Ear,
    Insect,
    Machine,
}

/// What a word means, if it names a part.
pub fn part(word: &str) -> Option<Part> {
    use Part::*;
    let is = |all: &[&str]| all.contains(&word);
    let ends = |all: &[&str]| all.iter().any(|end| word.ends_with(end));
    // Words that end like a part and are none.
    if is(&["armature", "alarm", "charm", "farm", "swarm", "armor", "armour", "footer", "handle", "legacy", "retail"]) {
        return None;
    }
    let found = if is(&["head", "neck", "jaw", "skull", "atama", "kubi", "face", "頭", "首"]) || ends(&["head"]) {
        Head
    } else if is(&[
        "spine", "chest", "torso", "hips", "hip", "pelvis", "abdomen", "tummy", "belly", "waist", "ribcage", "spline",
        "tors",
    ]) || is(&["上半身", "下半身", "腰", "センター"])
    {
        Spine
    } else if is(&[
        "shoulder",
        "shoulders",
        "clavicle",
        "clavicula",
        "collar",
        "collarbone",
        "elbow",
        "腕",
        "左腕",
        "右腕",
    ]) || is(&["左肩", "右肩", "ひじ", "左ひじ", "右ひじ"])
        || ends(&["arm", "arms"])
    {
        Arm
    } else if is(&["wrist", "palm", "palms", "fist", "左手首", "右手首"]) || ends(&["hand", "hands"]) {
        Hand
    } else if is(&["thumb", "index", "middle", "ring", "pinky", "little", "phalanx", "metacarpal", "左親指", "右親指"])
        || ends(&["finger", "fingers"])
    {
        Finger
    } else if is(&["thigh", "calf", "shin", "knee", "左足", "右足", "左ひざ", "右ひざ", "hock", "horselink"])
        || ends(&["leg", "legs"])
    {
        Leg
    } else if is(&["ankle", "toe", "toes", "feet", "paw", "hoof", "toebase", "左足首", "右足首"]) || ends(&["foot"])
    {
        Foot
    } else if is(&["tail", "tails", "queue", "尻尾", "しっぽ"]) {
        Tail
    } else if ends(&["wing", "wings"]) {
        Wing
    } else if is(&["feather", "feathers", "beak"]) {
        Feather
    } else if is(&["fin", "fins", "flipper", "flippers", "dorsal", "pectoral", "fluke", "gill", "gills", "caudal"]) {
        Fin
    } else if is(&["ear", "ears"]) {
        Ear
    } else if is(&[
        "thorax",
        "sting",
        "stinger",
        "antenna",
        "antennae",
        "mandible",
        "mandibles",
        "pincer",
        "pincers",
        "claw",
    ]) {
        Insect
    } else if machine(word) {
        Machine
    } else {
        return None;
    };
    Some(found)
}

fn machine(word: &str) -> bool {
    const WORDS: [&str; 44] = [
        "wheel",
        "wheels",
        "track",
        "turret",
        "gun",
        "cannon",
        "piston",
        "gear",
        "gears",
        "engine",
        "motor",
        "rotor",
        "propeller",
        "chassis",
        "axle",
        "steering",
        "door",
        "lid",
        "light",
        "lights",
        "lamp",
        "beam",
        "cable",
        "base",
        "flame",
        "flames",
        "fire",
        "button",
        "lever",
        "pivot",
        "antennas",
        "thruster",
        "exhaust",
        "suspension",
        "tire",
        "tyre",
        "car",
        "vehicle",
        "plane",
        "disc",
        "box",
        "chain",
        "screen",
        "key",
    ];
    WORDS.contains(&word) || word.ends_with("track") || word.ends_with("wheel")
}

/// A category that a word names by a creature; joints of bought animals are often called after them.
pub fn creature(word: &str) -> Option<super::Category> {
    use super::Category::*;
    const QUADRUPEDS: [&str; 42] = [
        "pig", "boar", "dog", "wolf", "fox", "cat", "lion", "tiger", "panther", "leopard", "horse", "donkey", "zebra",
        "mule", "cow", "bull", "ox", "bison", "buffalo", "sheep", "goat", "lamb", "deer", "stag", "elk", "moose",
        "antelope", "gazelle", "camel", "llama", "alpaca", "giraffe", "elephant", "rhino", "hippo", "rabbit", "hare",
        "rat", "mouse", "raccoon", "squirrel", "hyena",
    ];
    const BIRDS: [&str; 29] = [
        "bird",
        "chicken",
        "hen",
        "rooster",
        "turkey",
        "duck",
        "goose",
        "swan",
        "eagle",
        "hawk",
        "falcon",
        "owl",
        "crow",
        "raven",
        "parrot",
        "pigeon",
        "dove",
        "penguin",
        "ostrich",
        "peacock",
        "peafowl",
        "hummingbird",
        "flamingo",
        "seagull",
        "gull",
        "vulture",
        "phoenix",
        "bat",
        "stork",
    ];
    const ARTHROPODS: [&str; 20] = [
        "spider",
        "scorpion",
        "crab",
        "lobster",
        "shrimp",
        "insect",
        "beetle",
        "wasp",
        "hornet",
        "bee",
        "butterfly",
        "moth",
        "mantis",
        "cockroach",
        "dragonfly",
        "mosquito",
        "centipede",
        "tarantula",
        "grasshopper",
        "ladybug",
    ];
    const SWIMMERS: [&str; 18] = [
        "fish",
        "shark",
        "whale",
        "dolphin",
        "orca",
        "ray",
        "manta",
        "eel",
        "octopus",
        "squid",
        "seahorse",
        "seal",
        "walrus",
        "tuna",
        "salmon",
        "goldfish",
        "piranha",
        "jellyfish",
    ];
    const REPTILES: [&str; 24] = [
        "dragon",
        "wyvern",
        "dinosaur",
        "dino",
        "raptor",
        "velociraptor",
        "trex",
        "rex",
        "triceratops",
        "stegosaurus",
        "lizard",
        "gecko",
        "iguana",
        "chameleon",
        "crocodile",
        "alligator",
        "snake",
        "cobra",
        "python",
        "viper",
        "turtle",
        "tortoise",
        "frog",
        "toad",
    ];
    let is = |all: &[&str]| all.contains(&word);
    Some(if is(&QUADRUPEDS) {
        Quadruped
    } else if is(&BIRDS) {
        BirdFlying
    } else if is(&ARTHROPODS) {
        Arthropod
    } else if is(&SWIMMERS) {
        Aquatic
    } else if is(&REPTILES) {
        Reptile
    } else {
        return None;
    })
}

/// -1 for left, 1 for right.
pub fn side(words: &[String]) -> Option<i8> {
    let says = |all: &[&str], sign: char| words.iter().any(|w| all.contains(&w.as_str()) || w.starts_with(sign));
    if says(&["l", "left", "lf"], '左') {
        Some(-1)
    } else if says(&["r", "right", "rt"], '右') {
        Some(1)
    } else {
        None
    }
}

/// Whether a name without any part says which pair of legs it is of, and which piece of them: `front_upper.L`.
pub fn piece_of_leg(words: &[String]) -> bool {
    let says = |all: &[&str]| words.iter().any(|w| all.contains(&w.as_str()));
    says(&["front", "fore", "hind", "rear"]) && says(&["upper", "lower"])
}

/// Which of several pairs of legs: the words that say so, in order of the alphabet.
pub fn pair(words: &[String]) -> String {
    const WORDS: [&str; 13] = [
        "front", "fore", "back", "hind", "rear", "mid", "middle", "top", "bottom", "first", "second", "third", "fourth",
    ];
    let mut found: Vec<&str> = words.iter().map(String::as_str).filter(|w| WORDS.contains(w)).collect();
    // Run together, as in `frontLeg` written small.
    for word in words {
        found.extend(
            WORDS.iter().filter(|w| word.len() > w.len() && word.starts_with(*w) && part(&word[w.len()..]).is_some()),
        );
    }
    found.sort_unstable();
    found.dedup();
    found.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::words::words;

    #[test]
    fn conventions_name_the_same_parts() {
        for name in
            ["mixamorig:LeftUpLeg", "thigh.L", "Bip01 L Thigh", "J_Bip_L_UpperLeg", "leg_joint_L_1", "左足", "L_calf"]
        {
            let words = words(name);
            assert_eq!(words.iter().find_map(|w| part(w)), Some(Part::Leg), "{name}");
            assert_eq!(side(&words), Some(-1), "{name}");
        }
        assert_eq!(words("Armature").iter().find_map(|w| part(w)), None);
        assert_eq!(pair(&words("BackUpperLeg.R")), "back");
        assert_eq!(pair(&words("MidFrontLeg2.L")), "front mid");
        assert_eq!(pair(&words("jtBn_l_frontLeg_1")), "front");
        assert_eq!(pair(&words("frontleg_l")), "front");
        assert!(piece_of_leg(&words("front_upper.L")) && piece_of_leg(&words("hind_lower.R")));
        assert!(!piece_of_leg(&words("upper_back.L")) && !piece_of_leg(&words("front_wheel.L")));
        assert_eq!(creature("pig"), Some(crate::Category::Quadruped));
    }
}
