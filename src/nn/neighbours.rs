//! Lists of the agents that each agent can hear, for graphs among many agents of which each hears
//! few.

use tch::{Kind, Tensor};

use super::Packing;

/// Which agents each of the P agents of a packing can hear besides itself, as lists of at most K.
///
/// Attention over lists takes P · K steps where attention over all pairs takes P · N.
#[derive(Debug)]
pub struct Neighbours {
    /// Positions of the senders among the P agents, in the order of their slots, `[P, K]`. A list
    /// with fewer than K senders ends with the listener itself.
    senders: Tensor,
    /// 1 where a list has a sender, else 0, `[P, K]`.
    possible: Tensor,
}

impl Neighbours {
    /// Creates the lists from a physical mask `[B, N, N]` (0 cuts), in which each agent hears at
    /// most `most` others.
    ///
    /// # Panics
    /// If an agent hears more than `most` others, with debug assertions.
    pub fn of(physical: &Tensor, packing: &Packing, most: i64) -> Self {
        tch::no_grad(|| {
            let (_, places) = packing.size();
            let others = Tensor::eye(places, (Kind::Bool, physical.device())).logical_not();
            let heard = packing.pack(&physical.not_equal(0.0).logical_and(&others));
            let agents = heard.size()[0];
            let count = heard.sum_dim_intlist(-1, false, Kind::Int64);
            debug_assert!(
                agents == 0 || count.max().int64_value(&[]) <= most,
                "an agent hears {count:?} others"
            );
            let pairs = heard.nonzero();
            let (listener, slot) = (pairs.select(1, 0), pairs.select(1, 1));
            // The number of a sender in its list is its number among all pairs, less those of the
            // listeners before.
            let before = count.cumsum(0, Kind::Int64) - &count;
            let numbers = Tensor::arange(pairs.size()[0], (Kind::Int64, pairs.device()));
            let entry = &listener * most + numbers - before.index_select(0, &listener);
            let sender = packing.positions_in_row(&listener, &slot);
            let own = Tensor::arange(agents, (Kind::Int64, pairs.device()));
            let lists = own.unsqueeze(1).repeat([1, most]).view([-1]);
            Self {
                senders: lists.index_copy(0, &entry, &sender).view([agents, most]),
                possible: Tensor::zeros([agents * most], (Kind::Float, pairs.device()))
                    .index_fill(0, &entry, 1.0)
                    .view([agents, most]),
            }
        })
    }

    /// Returns the entries `x: [P, ..]` of each list's senders, `[P · K, ..]`.
    pub(super) fn of_senders(&self, x: &Tensor) -> Tensor {
        x.index_select(0, &self.senders.view([-1]))
    }

    /// Returns the entries `x: [P, width]` of each agent and of its list's senders, in this order,
    /// `[P, 1 + K, width]`.
    pub(super) fn of_self_and_senders(&self, x: &Tensor) -> Tensor {
        let (agents, most) = self.size();
        let own = Tensor::arange(agents, (Kind::Int64, x.device())).unsqueeze(1);
        let all = Tensor::cat(&[&own, &self.senders], 1);
        // The gradient of an embedding is faster than that of an index.
        let read = Tensor::embedding(&x.contiguous(), &all.view([-1]), -1, false, false);
        read.view([agents, 1 + most, -1])
    }

    /// Returns 1 where a list has a sender, else 0, `[P, K]`.
    pub(super) fn possible(&self) -> &Tensor {
        &self.possible
    }

    /// Returns the numbers P of agents and K of entries per list.
    pub(super) fn size(&self) -> (i64, i64) {
        self.senders.size2().expect("lists are [P, K]")
    }

    /// Returns entries `[P, K]` of the lists in their places in a matrix `[B, N, N]`, row =
    /// listener. What the diagonal contains is not defined.
    pub(super) fn to_full(&self, edges: &Tensor, packing: &Packing) -> Tensor {
        let (rows, places) = packing.size();
        let (agents, most) = self.size();
        let own = Tensor::arange(agents, (Kind::Int64, edges.device())).unsqueeze(1);
        let listener = packing.slots(&own.repeat([1, most]).view([-1]));
        let sender = packing.slots(&self.senders.view([-1])).remainder(places);
        let full = Tensor::zeros([rows * places * places], (Kind::Float, edges.device()));
        // Ends of lists lie on the diagonal.
        let full = full.index_copy(0, &(listener * places + sender), &edges.reshape([-1]));
        full.view([rows, places, places])
    }
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;

    #[test]
    fn lists_have_the_senders_of_the_mask_in_the_order_of_their_slots() {
        // Agents 0, 1, 3 of the first row and 2 of the second; 0 hears 1 and 3, 3 hears 0.
        let physical = Tensor::zeros([2, 4, 4], (Kind::Float, Device::Cpu));
        for (row, listener, sender) in
            [(0, 0, 0), (0, 1, 1), (0, 3, 3), (1, 2, 2), (0, 0, 1), (0, 0, 3), (0, 3, 0)]
        {
            let _ = physical.get(row).get(listener).get(sender).fill_(1.0);
        }
        let packing = Packing::of(&physical.diagonal(0, 1, 2));
        let lists = Neighbours::of(&physical, &packing, 2);
        let senders = Vec::<i64>::try_from(lists.senders.view([-1])).expect("numbers");
        assert_eq!(senders, [1, 2, 1, 1, 0, 2, 3, 3]);
        let possible = Vec::<f32>::try_from(lists.possible.view([-1])).expect("numbers");
        assert_eq!(possible, [1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
        let others: Tensor = 1.0 - Tensor::eye(4, (Kind::Float, Device::Cpu));
        let full = lists.to_full(&lists.possible, &packing) * &others;
        assert!(full.equal(&(physical * others)), "{full:?}");
    }

    #[test]
    fn all_slots_have_lists_where_all_count_as_occupied() {
        let physical = Tensor::from_slice(&[1_f32, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
        let lists = Neighbours::of(&physical.view([1, 3, 3]), &Packing::full(1, 3), 1);
        let senders = Vec::<i64>::try_from(lists.senders.view([-1])).expect("numbers");
        assert_eq!(senders, [2, 1, 2]);
        assert_eq!(Vec::<f32>::try_from(lists.possible.view([-1])).unwrap(), [1.0, 0.0, 0.0]);
    }
}
