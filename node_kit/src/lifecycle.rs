//! States and transitions of a managed node, with the numbers of `lifecycle_msgs`.

/// A primary state.
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
}

impl LifecycleState {
    /// All, by number.
    pub const ALL: [Self; 4] = [Self::Unconfigured, Self::Inactive, Self::Active, Self::Finalized];

    /// Name, as `ros2 lifecycle get` prints it.
    pub const fn label(self) -> &'static str {
        match self {
            Self::Unconfigured => "unconfigured",
            Self::Inactive => "inactive",
            Self::Active => "active",
            Self::Finalized => "finalized",
        }
    }
}

/// A transition between states.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Transition {
    /// Opens topics and devices with the current parameters.
    Configure = 1,
    /// Closes topics and devices.
    Cleanup = 2,
    /// Starts to handle inputs.
    Activate = 3,
    /// Stops to handle inputs.
    Deactivate = 4,
    /// Ends, from unconfigured.
    UnconfiguredShutdown = 5,
    /// Ends, from inactive.
    InactiveShutdown = 6,
    /// Ends, from active.
    ActiveShutdown = 7,
}

impl Transition {
    /// All, by number.
    pub const ALL: [Self; 7] = [
        Self::Configure,
        Self::Cleanup,
        Self::Activate,
        Self::Deactivate,
        Self::UnconfiguredShutdown,
        Self::InactiveShutdown,
        Self::ActiveShutdown,
    ];

    /// Name, as in `ros2 lifecycle set`.
    pub const fn label(self) -> &'static str {
        match self {
            Self::Configure => "configure",
            Self::Cleanup => "cleanup",
            Self::Activate => "activate",
            Self::Deactivate => "deactivate",
            Self::UnconfiguredShutdown | Self::InactiveShutdown | Self::ActiveShutdown => {
                "shutdown"
            }
        }
    }

    /// Start and goal state.
    pub const fn ends(self) -> (LifecycleState, LifecycleState) {
        use LifecycleState as S;
        match self {
            Self::Configure => (S::Unconfigured, S::Inactive),
            Self::Cleanup => (S::Inactive, S::Unconfigured),
            Self::Activate => (S::Inactive, S::Active),
            Self::Deactivate => (S::Active, S::Inactive),
            Self::UnconfiguredShutdown => (S::Unconfigured, S::Finalized),
            Self::InactiveShutdown => (S::Inactive, S::Finalized),
            Self::ActiveShutdown => (S::Active, S::Finalized),
        }
    }

    /// The transition that a `ChangeState` request names, if it is possible from `state`: by
    /// number, or by label if the number is zero.
    pub fn requested(state: LifecycleState, id: u8, label: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .filter(|t| t.ends().0 == state)
            .find(|t| if id == 0 { t.label() == label } else { *t as u8 == id })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_possible_transitions_are_found() {
        use LifecycleState as S;
        assert_eq!(Transition::requested(S::Unconfigured, 1, ""), Some(Transition::Configure));
        assert_eq!(Transition::requested(S::Active, 1, ""), None);
        assert_eq!(
            Transition::requested(S::Active, 0, "shutdown"),
            Some(Transition::ActiveShutdown)
        );
        assert_eq!(
            Transition::requested(S::Inactive, 0, "shutdown"),
            Some(Transition::InactiveShutdown)
        );
        assert_eq!(Transition::requested(S::Finalized, 0, "configure"), None);
    }
}
