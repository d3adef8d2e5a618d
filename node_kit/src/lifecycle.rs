//! States and transitions of a managed node, with the numbers and labels of `lifecycle_msgs`.

/// A state: a primary one, or one of a transition that is under way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum LifecycleState {
    /// Parameters and services exist, topics and devices do not.
    Unconfigured = 1,
    /// Topics and devices are open; inputs are dropped, and nothing is published.
    Inactive = 2,
    /// Inputs are handled.
    Active = 3,
    /// Ended; the node waits for its process to end.
    Finalized = 4,
    /// Topics and devices are being opened.
    Configuring = 10,
    /// Topics and devices are being closed.
    CleaningUp = 11,
    /// The node is being ended.
    ShuttingDown = 12,
    /// Inputs are about to be handled.
    Activating = 13,
    /// Inputs are no longer handled.
    Deactivating = 14,
}

impl LifecycleState {
    /// All, by number.
    pub const ALL: [Self; 9] = [
        Self::Unconfigured,
        Self::Inactive,
        Self::Active,
        Self::Finalized,
        Self::Configuring,
        Self::CleaningUp,
        Self::ShuttingDown,
        Self::Activating,
        Self::Deactivating,
    ];

    /// Name, as `ros2 lifecycle get` prints it: the variant's in lower case.
    pub fn label(self) -> String {
        format!("{self:?}").to_lowercase()
    }
}

/// A requested transition between primary states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transition {
    /// Number of the request.
    pub id: u8,
    /// Name, as in `ros2 lifecycle set`.
    pub label: &'static str,
    /// State in which it is possible, and to which the node returns if it fails.
    pub start: LifecycleState,
    /// State while it is under way.
    pub through: LifecycleState,
    /// State after it.
    pub goal: LifecycleState,
}

const fn row(
    id: u8,
    label: &'static str,
    [start, through, goal]: [LifecycleState; 3],
) -> Transition {
    Transition { id, label, start, through, goal }
}

impl Transition {
    /// Opens topics and devices with the current parameters.
    pub const CONFIGURE: Self = Self::ALL[0];
    /// Starts to handle inputs.
    pub const ACTIVATE: Self = Self::ALL[2];

    /// All, by number.
    pub const ALL: [Self; 7] = {
        use LifecycleState::{
            Activating, Active, CleaningUp, Configuring, Deactivating, Finalized, Inactive,
            ShuttingDown, Unconfigured,
        };
        [
            row(1, "configure", [Unconfigured, Configuring, Inactive]),
            row(2, "cleanup", [Inactive, CleaningUp, Unconfigured]),
            row(3, "activate", [Inactive, Activating, Active]),
            row(4, "deactivate", [Active, Deactivating, Inactive]),
            row(5, "shutdown", [Unconfigured, ShuttingDown, Finalized]),
            row(6, "shutdown", [Inactive, ShuttingDown, Finalized]),
            row(7, "shutdown", [Active, ShuttingDown, Finalized]),
        ]
    };

    /// The transition that a `ChangeState` request names, if it is possible from `state`: by
    /// number, or by label if the number is zero.
    pub fn requested(state: LifecycleState, id: u8, label: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .filter(|t| t.start == state)
            .find(|t| if id == 0 { t.label == label } else { t.id == id })
    }

    /// Number and name of the transition out of [`Transition::through`].
    pub const fn end(self, success: bool) -> (u8, &'static str) {
        // `TRANSITION_ON_CONFIGURE_SUCCESS` is 10, `…_FAILURE` 11; the three shutdowns share 50.
        let tens = if self.id < 5 { 10 * self.id } else { 50 };
        if success { (tens, "transition_success") } else { (tens + 1, "transition_failure") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_possible_transitions_are_found() {
        use LifecycleState as S;
        let goal = |state, id, label| Transition::requested(state, id, label).map(|t| t.goal);
        assert_eq!(Transition::requested(S::Unconfigured, 1, ""), Some(Transition::CONFIGURE));
        assert_eq!(Transition::requested(S::Inactive, 0, "activate"), Some(Transition::ACTIVATE));
        assert_eq!(goal(S::Active, 1, ""), None);
        assert_eq!(goal(S::Active, 0, "shutdown"), Some(S::Finalized));
        assert_eq!(goal(S::Configuring, 5, ""), None);
        assert_eq!(goal(S::Finalized, 0, "configure"), None);
    }

    /// The numbers of `lifecycle_msgs/Transition` and `State`.
    #[test]
    fn each_transition_leads_through_a_state_of_its_own() {
        let rows = Transition::ALL.map(|t| (t.id, t.through as u8, t.end(true).0));
        let expected = [
            (1, 10, 10),
            (2, 11, 20),
            (3, 13, 30),
            (4, 14, 40),
            (5, 12, 50),
            (6, 12, 50),
            (7, 12, 50),
        ];
        assert_eq!(rows, expected);
        assert_eq!(Transition::CONFIGURE.end(false), (11, "transition_failure"));
    }
}
