//! Draws of traits: what varies from creature to creature, and by how much.

use riglab_random::{Draw, Stream};

/// The random stream of one creature.
pub(crate) struct Dice(Stream);

impl Dice {
    pub fn new(stream: Stream) -> Self {
        Self(stream)
    }

    /// Uniform in [low, high).
    pub fn between(&mut self, low: f32, high: f32) -> f32 {
        self.0.within(low, high)
    }

    /// Between -1 and 1, bell-shaped: extremes are rare, monsters impossible.
    ///
    /// A sum of uniform draws instead of a normal one: it is bounded, and plain arithmetic on
    /// every machine.
    pub fn bell(&mut self) -> f32 {
        (self.0.unit() + self.0.unit() + self.0.unit()) * (2.0 / 3.0) - 1.0
    }

    pub fn chance(&mut self, p: f32) -> bool {
        self.0.chance(p)
    }

    /// Uniform in 0..n.
    pub fn below(&mut self, n: usize) -> usize {
        self.0.below(n)
    }

    /// Uniform in low..=high.
    pub fn count(&mut self, low: usize, high: usize) -> usize {
        low + self.0.below(high - low + 1)
    }
}

/// Defines a struct of plain numbers that can be mixed and varied: the proportions of a body plan.
///
/// A plan lists a few archetypes (wolf, horse, ...) and draws a creature between two of them, so
/// that every creature resembles something and no two look alike.
macro_rules! proportions {
    ($(#[$meta:meta])* $name:ident { $($(#[$doc:meta])* $field:ident),+ $(,)? }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug)]
        pub(crate) struct $name { $($(#[$doc])* pub $field: f32),+ }

        impl $name {
            /// A creature between two archetypes, nearer to the first, each trait varied by at most
            /// the share `spread`.
            pub fn draw(archetypes: &[Self], spread: f32, dice: &mut $crate::dice::Dice) -> Self {
                let a = archetypes[dice.below(archetypes.len())];
                let b = archetypes[dice.below(archetypes.len())];
                // Squared: most creatures are mainly one kind.
                let t = dice.between(0.0, 0.75);
                let t = t * t;
                Self { $($field: (a.$field + t * (b.$field - a.$field)) * (1.0 + spread * dice.bell())),+ }
            }
        }
    };
}
pub(crate) use proportions;
