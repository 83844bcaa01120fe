! Optimize: -O3
!> Memory of the past with constant size: the kernel as a sum of exponentials for all lags of
!! at least the first node's, each with its own convolution
!!
!!   H_q(t) = integral_0^t exp(-r_q (t - s)) g(s) ds,
!!   H_q(t + h) = exp(-r_q h) H_q(t) + h sum_k phi_qk g_k,
!!
!! with phi exact for the polynomial through the points of a step. The cost of a
!! step and the storage do not grow with time.
module viscovib_exponential_history
  use viscovib_known_past, only: known_past_type
  use viscovib_memory_channels, only: channels_type
  use viscovib_collocation, only: collocation_type
  use viscovib_gauss_points, only: points_16, points_32, weights_16, weights_32
  use viscovib_history, only: history_type, past_type
  use viscovib_kernel, only: decay_nodes, panel_nodes, vanished
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: exponential_history_type, exponential_moments, new_exponential_history

  !> Terms processed together in `store`, nodes in `recall`.
  integer, parameter :: block = 8, few = 4

  !> Number of step lengths whose weights are kept.
  integer, parameter :: most_lengths = 64

  !> Weights of exponentials for steps of one length.
  type :: weights_type
    real(wp) :: h = 0.0_wp
    !> Weights times exp(-r_q c_i h), nodes by fours (padded), shape (few, n_terms, n_fours).
    real(wp), allocatable :: recall(:, :, :)
    !> exp(-r_q h), and h phi, shapes (n_padded) and (n_padded, 0:s+1).
    real(wp), allocatable :: decay(:), gain(:, :)
  end type weights_type

  !> The exponentials of one kernel and the channels with this kernel.
  type :: group_type
    integer :: first = 0, last = 0, n_terms = 0
    !> Weights (with the scale of the memory) and rates of the terms.
    real(wp), allocatable :: terms(:), rates(:)
    !> Weights for each step length, and the index of the present one.
    type(weights_type), allocatable :: lengths(:)
    integer :: now = 1, n_lengths = 0
    !> H, shape (n_padded, first:last).
    real(wp), allocatable :: state(:, :)
  end type group_type

  type, extends(history_type) :: exponential_history_type
    integer :: s = 0
    real(wp) :: h = 0.0_wp
    type(collocation_type), private :: table
    type(group_type), allocatable :: groups(:)
  contains
    procedure :: recall
    procedure :: store
    procedure :: add_known_past
    procedure :: begin
    procedure :: change_step
    procedure :: memory_size
    procedure :: save_memory
    procedure :: load_memory
  end type exponential_history_type

contains

  !> `possible` is false if a kernel has no sum of exponentials.
  subroutine new_exponential_history(history, system, channels, table, h, least, t_end, &
                                     tolerance, possible)
    type(exponential_history_type), intent(out) :: history
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    type(collocation_type), intent(in) :: table
    !> Step, and the shortest that may follow; latest time of any run that continues
    !! this one; relative error.
    real(wp), intent(in) :: h, least, t_end, tolerance
    logical, intent(out) :: possible
    real(wp), allocatable :: weights(:), rates(:)
    integer :: first, last, n, i, k, padded

    possible = .true.
    history%s = table%s
    history%table = table
    history%kernel_of = channels%kernel_of
    n = 0
    do k = 1, size(system%kernels)
      if (any(channels%kernel_of == k)) n = n + 1
    end do
    allocate (history%groups(n))
    last = 0
    do i = 1, n
      first = last + 1
      k = channels%kernel_of(first)
      last = first + count(channels%kernel_of == k) - 1
      call system%kernels(k)%exponentials(tolerance, least*table%points(1), &
                                                 max(t_end, 2.0_wp*h), weights, rates)
      possible = size(rates) > 0
      if (.not. possible) return
      associate (group => history%groups(i))
        group%first = first
        group%last = last
        group%n_terms = size(rates)
        padded = (size(rates) + block - 1)/block*block
        group%terms = weights
        group%rates = rates
        allocate (group%lengths(1), group%state(padded, first:last))
        group%state = 0.0_wp
      end associate
    end do
    call history%change_step(h)
  end subroutine new_exponential_history

  subroutine change_step(self, h)
    class(exponential_history_type), intent(inout) :: self
    real(wp), intent(in) :: h
    type(weights_type), allocatable :: grown(:)
    integer :: i, k

    self%h = h
    do i = 1, size(self%groups)
      associate (group => self%groups(i))
        do k = 1, group%n_lengths
          if (abs(group%lengths(k)%h - h) <= 0.0_wp) exit
        end do
        group%now = k
        if (k <= group%n_lengths) cycle
        if (k > most_lengths) then
          ! Discard the stored lengths.
          group%now = 1
          group%n_lengths = 0
        else if (k > size(group%lengths)) then
          allocate (grown(min(most_lengths, 2*k)))
          grown(:k - 1) = group%lengths
          call move_alloc(grown, group%lengths)
        end if
        group%n_lengths = group%n_lengths + 1
        call set_weights(self%table, group%terms, group%rates, size(group%state, 1), h, &
                         group%lengths(group%now))
      end associate
    end do
  end subroutine change_step

  !> Weights of steps h; `padded`: length of states.
  subroutine set_weights(table, terms, rates, padded, h, weights)
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: terms(:), rates(:), h
    integer, intent(in) :: padded
    type(weights_type), intent(out) :: weights
    integer :: j, k

    weights%h = h
    allocate (weights%recall(few, size(rates), (table%s + few - 1)/few), weights%decay(padded))
    allocate (weights%gain(padded, 0:table%s + 1))
    weights%recall = 0.0_wp
    weights%decay = 0.0_wp
    weights%gain = 0.0_wp
    do k = 1, size(rates)
      do j = 1, table%s
        weights%recall(modulo(j - 1, few) + 1, k, (j - 1)/few + 1) = &
          terms(k)*exp(-min(rates(k)*h*table%points(j), 700.0_wp))
      end do
      weights%decay(k) = exp(-min(rates(k)*h, 700.0_wp))
    end do
    call exponential_moments(table, h*rates, weights%gain(:size(rates), :))
    weights%gain = h*weights%gain
  end subroutine set_weights

  !> integral_0^1 exp(-z (1-x)) l_k(x) dx for the polynomials of the points; over the
  !! part where the exponential has not vanished.
  subroutine exponential_moments(table, z, moments)
    type(collocation_type), intent(in) :: table
    !> Shape (n), >= 0.
    real(wp), intent(in) :: z(:)
    !> Shape (n, 0:s+1).
    real(wp), intent(out) :: moments(:, 0:)
    real(wp) :: few_basis(0:table%s + 1, panel_nodes), length
    integer :: k, q

    do k = 1, panel_nodes
      few_basis(:, k) = table%basis(1.0_wp - points_16(k))
    end do
    moments = 0.0_wp
    do q = 1, size(z)
      if (z(q) < 6.0_wp) then
        moments(q, :) = matmul(few_basis, weights_16*exp(-z(q)*points_16))
      else
        length = min(1.0_wp, vanished/z(q))
        do k = 1, decay_nodes
          moments(q, :) = moments(q, :) + length*weights_32(k)*exp(-z(q)*length*points_32(k)) &
                          *table%basis(1.0_wp - length*points_32(k))
        end do
      end if
    end do
  end subroutine exponential_moments

  subroutine recall(self, remembered)
    class(exponential_history_type), intent(in) :: self
    real(wp), intent(out), contiguous :: remembered(:)
    integer :: i, c

    do i = 1, size(self%groups)
      associate (group => self%groups(i), weights => self%groups(i)%lengths(self%groups(i)%now))
        do c = group%first, group%last
          call recall_channel(group%n_terms, size(weights%recall, 3), self%s, weights%recall, &
                              group%state(:, c), remembered((c - 1)*self%s + 1:c*self%s))
        end do
      end associate
    end do
  end subroutine recall

  pure subroutine recall_channel(n, n_fours, s, weights, state, remembered)
    integer, intent(in) :: n, n_fours, s
    real(wp), intent(in) :: weights(few, n, n_fours), state(n)
    real(wp), intent(out) :: remembered(s)
    real(wp), dimension(few) :: one, two, three, four
    integer :: i, q

    ! Four independent sums, since each addition waits for the one before.
    do i = 1, n_fours
      one = 0.0_wp
      two = 0.0_wp
      three = 0.0_wp
      four = 0.0_wp
      !GCC$ novector
      do q = 1, n/4
        one = one + weights(:, 4*q - 3, i)*state(4*q - 3)
        two = two + weights(:, 4*q - 2, i)*state(4*q - 2)
        three = three + weights(:, 4*q - 1, i)*state(4*q - 1)
        four = four + weights(:, 4*q, i)*state(4*q)
      end do
      !GCC$ novector
      do q = n - mod(n, 4) + 1, n
        one = one + weights(:, q, i)*state(q)
      end do
      one = (one + two) + (three + four)
      remembered(few*(i - 1) + 1:min(few*i, s)) = one(:min(few, s - few*(i - 1)))
    end do
  end subroutine recall_channel

  subroutine store(self, g)
    class(exponential_history_type), intent(inout) :: self
    real(wp), intent(in), contiguous :: g(0:, :)
    integer :: i, c

    do i = 1, size(self%groups)
      associate (weights => self%groups(i)%lengths(self%groups(i)%now))
        do c = self%groups(i)%first, self%groups(i)%last
          call store_channel(size(weights%decay), self%s + 2, weights%decay, weights%gain, &
                             g(:, c), self%groups(i)%state(:, c))
        end do
      end associate
    end do
  end subroutine store

  pure subroutine store_channel(n, n_points, decay, gain, g, state)
    integer, intent(in) :: n, n_points
    real(wp), intent(in) :: decay(block, n/block), gain(block, n/block, n_points), g(n_points)
    real(wp), intent(inout) :: state(block, n/block)
    real(wp) :: sums(block)
    integer :: b, k

    do b = 1, n/block
      sums = decay(:, b)*state(:, b)
      !GCC$ novector
      do k = 1, n_points
        sums = sums + gain(:, b, k)*g(k)
      end do
      state(:, b) = sums
    end do
  end subroutine store_channel

  subroutine add_known_past(self, known_past)
    class(exponential_history_type), intent(inout) :: self
    type(known_past_type), intent(in) :: known_past
    real(wp), allocatable :: moments(:, :), fading(:)
    real(wp) :: length
    integer :: i, c, p

    do i = 1, size(self%groups)
      associate (group => self%groups(i))
        allocate (moments(group%n_terms, 0:known_past%table%s + 1))
        do p = 1, size(known_past%g, 3)
          length = known_past%times(p) - known_past%times(p - 1)
          call exponential_moments(known_past%table, length*group%rates, moments)
          fading = length*exp(-min(-group%rates*known_past%times(p), 700.0_wp))
          do c = group%first, group%last
            group%state(:group%n_terms, c) = group%state(:group%n_terms, c) &
                                             + fading*matmul(moments, known_past%g(:, c, p))
          end do
        end do
        deallocate (moments)
      end associate
    end do
  end subroutine add_known_past

  subroutine begin(self, table, past)
    class(exponential_history_type), intent(inout) :: self
    type(collocation_type), intent(in) :: table
    type(past_type), intent(in) :: past
    real(wp), allocatable :: moments(:, :)
    integer :: i, c, q

    do i = 1, size(self%groups)
      associate (group => self%groups(i))
        allocate (moments(group%n_terms, 0:table%s + 1))
        call exponential_moments(table, past%length*group%rates, moments)
        do c = group%first, group%last
          do q = 1, group%n_terms
            group%state(q, c) = &
              group%lengths(group%now)%decay(q)*group%state(q, c) &
              + past%length*dot_product(moments(q, :), past%last(:, c)) &
              + sum(past%masses(:, c)*exp(-min(group%rates(q)*(self%h - past%times), 700.0_wp)))
          end do
        end do
        deallocate (moments)
      end associate
    end do
  end subroutine begin

  pure integer function memory_size(self)
    class(exponential_history_type), intent(in) :: self
    integer :: i
    memory_size = 0
    do i = 1, size(self%groups)
      memory_size = memory_size + size(self%groups(i)%state)
    end do
  end function memory_size

  pure function save_memory(self) result(memory)
    class(exponential_history_type), intent(in) :: self
    real(wp) :: memory(self%memory_size())
    integer :: i, at
    at = 0
    do i = 1, size(self%groups)
      associate (state => self%groups(i)%state)
        memory(at + 1:at + size(state)) = reshape(state, [size(state)])
        at = at + size(state)
      end associate
    end do
  end function save_memory

  subroutine load_memory(self, memory)
    class(exponential_history_type), intent(inout) :: self
    real(wp), intent(in) :: memory(:)
    integer :: i, at, n
    at = 0
    do i = 1, size(self%groups)
      n = size(self%groups(i)%state)
      self%groups(i)%state(:, :) = reshape(memory(at + 1:at + n), &
                                           shape(self%groups(i)%state))
      at = at + n
    end do
  end subroutine load_memory

end module viscovib_exponential_history
