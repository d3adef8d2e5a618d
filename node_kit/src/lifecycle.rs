//! The states of a managed node and the ways between them, as `lifecycle_msgs` numbers them.

/// A primary state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum LifecycleState {
    /// There, with its parameters and services, but without topics and devices.
    Unconfigured = 1,
    /// Topics and devices are open; what comes is let go, nothing is published.
    Inactive = 2,
    /// At work.
    Active = 3,
    /// Done; it waits for its process to end.
    Finalized = 4,
}

impl LifecycleState {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Unconfigured, Self::Inactive, Self::Active, Self::Finalized];

    /// As `ros2 lifecycle get` says it.
    pub const fn label(self) -> &'static str {
        match self {
            Self::Unconfigured => "unconfigured",
            Self::Inactive => "inactive",
            Self::Active => "active",
            Self::Finalized => "finalized",
        }
    }
}

/// A way from one state to another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Transition {
    /// Takes its parameters and opens topics and devices.
    Configure = 1,
    /// Closes them.
    Cleanup = 2,
    /// Begins to work.
    Activate = 3,
    /// Pauses.
    Deactivate = 4,
    /// Ends, from unconfigured.
    UnconfiguredShutdown = 5,
    /// Ends, from inactive.
    InactiveShutdown = 6,
    /// Ends, from active.
    ActiveShutdown = 7,
}

impl Transition {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::Configure,
        Self::Cleanup,
        Self::Activate,
        Self::Deactivate,
        Self::UnconfiguredShutdown,
        Self::InactiveShutdown,
        Self::ActiveShutdown,
    ];

    /// As `ros2 lifecycle set` takes it.
    pub const fn label(self) -> &'static str {
        match self {
            Self::Configure => "configure",
            Self::Cleanup => "cleanup",
            Self::Activate => "activate",
            Self::Deactivate => "deactivate",
            Self::UnconfiguredShutdown | Self::InactiveShutdown | Self::ActiveShutdown => "shutdown",
        }
    }

    /// Where it starts and where it leads.
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

    /// The one that a `ChangeState` request means, where it is possible from `state`: by its number, or by its label where
    /// the number is zero.
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
    fn a_request_is_taken_only_where_it_is_possible() {
        use LifecycleState as S;
        assert_eq!(Transition::requested(S::Unconfigured, 1, ""), Some(Transition::Configure));
        assert_eq!(Transition::requested(S::Active, 1, ""), None);
        assert_eq!(Transition::requested(S::Active, 0, "shutdown"), Some(Transition::ActiveShutdown));
        assert_eq!(Transition::requested(S::Inactive, 0, "shutdown"), Some(Transition::InactiveShutdown));
        assert_eq!(Transition::requested(S::Finalized, 0, "configure"), None);
    }
}
