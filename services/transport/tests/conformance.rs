//! One suite of promises, kept by every carrier.

#[path = "conformance/delivery.rs"]
mod delivery;
#[path = "conformance/fixture.rs"]
mod fixture;
#[path = "conformance/hostile.rs"]
mod hostile;
#[path = "conformance/joining.rs"]
mod joining;
#[path = "conformance/refusal.rs"]
mod refusal;
#[path = "conformance/waiting.rs"]
mod waiting;

/// Instantiates each promise for each carrier.
macro_rules! every_carrier_keeps {
    ($($file:ident { $($promise:ident,)+ })+) => {
        mod memory {
            $($(#[test]
            fn $promise() -> crate::fixture::Outcome {
                crate::$file::$promise::<crate::fixture::Memory>()
            })+)+
        }
        mod shared_memory {
            $($(#[test]
            fn $promise() -> crate::fixture::Outcome {
                crate::$file::$promise::<crate::fixture::Shared>()
            })+)+
        }
    };
}

every_carrier_keeps! {
    delivery {
        messages_arrive_in_order,
        every_kind_of_message_crosses_whole,
        of_too_many_messages_the_newest_win_and_the_rest_are_counted,
        the_latest_message_passes_over_the_older_ones,
        the_latest_message_is_of_the_greatest_epoch,
        a_reader_that_never_reads_does_not_stop_the_control_path,
        nothing_is_lost_in_lock_step,
        a_lossless_writer_gives_up_when_its_patience_is_over,
        each_writer_of_a_topic_is_counted_by_itself,
        a_snapshot_of_a_megabyte_crosses_whole,
    }
    joining {
        a_late_joiner_gets_the_last_snapshot,
        a_late_joiner_counts_no_losses_from_before_its_time,
        a_restarted_writer_is_received_at_once,
        a_new_epoch_starts_at_sequence_one,
        a_restarted_reader_receives_what_comes_next,
        a_place_that_is_left_can_be_taken_again,
        two_graphs_do_not_receive_each_other,
    }
    hostile {
        another_version_is_refused_with_both_named,
        another_kind_is_refused_with_both_named,
        damaged_truncated_and_oversize_bytes_are_refused,
        a_message_sent_twice_is_received_once,
        a_snapshot_that_promises_more_points_than_it_has_is_refused,
    }
    waiting {
        a_wait_ends_when_a_message_comes,
        a_wait_ends_without_a_message_when_its_time_is_over,
        a_wait_is_over_at_once_when_a_message_is_there_already,
        a_wait_does_not_end_for_what_has_been_taken_already,
        no_wake_up_is_lost_among_many,
    }
}
