//! Directives, with which a supervisor changes the motion of the hand.

/// Request of a supervisor to the hand.
#[derive(Debug, Clone, PartialEq)]
pub enum Directive {
    /// Plays the gait; a shift of the fingers fades out, and held fingers move on.
    Continue,
    /// Changes to the shipped gait of this name. Gravity and torque limits stay.
    SwitchGait(String),
    /// Changes to the shipped controller of this name, also about another axis: the hand opens, the palm is levelled and tilted as
    /// the controller needs it, and the hand closes. It takes two seconds. The torque limit stays.
    ChangeController(String),
    /// Opens the fingers for a moment and closes them again.
    Regrasp,
    /// Plays the gait with shifted fingers, which push the object back.
    Recentre {
        /// Displacement of the object from its place, x and y in the world, metres.
        offset_m: [f64; 2],
    },
    /// Keeps the fingers where they are until another directive.
    Hold,
    /// Ends the episode.
    Stop,
}
