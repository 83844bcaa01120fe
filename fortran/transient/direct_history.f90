! Optimize: -O3
!> The whole past, step by step, with exact weights for every lag: cost N^2, any
!! kernel. Reference for the sums of exponentials, and suitable for short runs. Weights of
!! consecutive equal steps are kept; those of other pairs of steps are recomputed.
module viscovib_direct_history
  use viscovib_kernel_holder, only: copy_kernels, kernel_holder
  use viscovib_known_past, only: known_past_type
  use viscovib_memory_channels, only: channels_type
  use viscovib_collocation, only: collocation_type
  use viscovib_history, only: history_type, past_type
  use viscovib_gauss_points, only: points_32, weights_32
  use viscovib_kernel, only: decay_nodes
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: direct_history_type, new_direct_history

  type, extends(history_type) :: direct_history_type
    integer :: s = 0, n_stored = 0, n_lags = 0
    !> Number of stored steps before those of the present length.
    integer :: n_other = 0
    !> Length of a step, and start time of the present one.
    real(wp) :: h = 0.0_wp, now = 0.0_wp
    type(collocation_type) :: table
    type(kernel_holder), allocatable :: kernels(:)
    !> Weight of point k, d steps before node i's step, for each kernel, shape
    !! (0:s+1, s, n_lags, n_kernels).
    real(wp), allocatable :: weights(:, :, :, :)
    !> Channels at the points of the steps made, shape (0:s+1, n_channels, n).
    real(wp), allocatable :: g(:, :, :)
    !> Start times and lengths of these steps, shape (n).
    real(wp), allocatable :: begins(:), lengths(:)
    !> Point masses of the first step if it consisted of panels.
    real(wp), allocatable :: times(:), masses(:, :)
    !> The motion before t = 0.
    type(known_past_type) :: known_past
  contains
    procedure :: recall
    procedure :: store
    procedure :: add_known_past
    procedure :: begin
    procedure :: change_step
    procedure :: memory_size
    procedure :: save_memory
    procedure :: load_memory
  end type direct_history_type

contains

  subroutine new_direct_history(history, system, channels, table, h)
    type(direct_history_type), intent(out) :: history
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: h

    history%s = table%s
    history%h = h
    history%table = table
    history%kernel_of = channels%kernel_of
    call copy_kernels(system%kernels, history%kernels)
    allocate (history%weights(0:table%s + 1, table%s, 0, size(system%kernels)))
    allocate (history%g(0:table%s + 1, size(channels%kernel_of), 0))
    allocate (history%times(0), history%masses(0, size(channels%kernel_of)))
    allocate (history%begins(0), history%lengths(0))
  end subroutine new_direct_history

  subroutine recall(self, remembered)
    class(direct_history_type), intent(in) :: self
    real(wp), intent(out), contiguous :: remembered(:)
    real(wp) :: values(size(self%times)), before(size(self%kernel_of)), now
    integer :: at, i, c, d

    remembered = 0.0_wp
    do c = 1, size(self%kernel_of)
      do d = 1, self%n_stored - self%n_other
        do i = 1, self%s
          at = (c - 1)*self%s + i
          remembered(at) = remembered(at) + dot_product(self%weights(:, i, d, self%kernel_of(c)), &
                                                        self%g(:, c, self%n_stored + 1 - d))
        end do
      end do
    end do
    if (self%n_other > 0) call add_others(self, remembered)
    if (self%known_past%is_known()) then
      do i = 1, self%s
        now = self%now + self%h*self%table%points(i)
        call self%known_past%recall(self%kernels, self%kernel_of, now, before)
        remembered(i::self%s) = remembered(i::self%s) + before
      end do
    end if
    if (size(self%times) == 0) return
    do i = 1, self%s
      now = self%now + self%h*self%table%points(i)
      do c = 1, size(self%kernel_of)
        call self%kernels(self%kernel_of(c))%value(now - self%times, values)
        at = (c - 1)*self%s + i
        remembered(at) = remembered(at) + dot_product(values, self%masses(:, c))
      end do
    end do
  end subroutine recall

  !> Add the memory of steps of other lengths to the nodes.
  subroutine add_others(self, remembered)
    class(direct_history_type), intent(in) :: self
    real(wp), intent(inout) :: remembered(:)
    real(wp), allocatable :: sigma(:), w(:)
    real(wp) :: weights(0:self%s + 1), lag
    integer :: at, c, d, i, k, m

    do m = 1, size(self%kernels)
      if (.not. any(self%kernel_of == m)) cycle
      do d = 1, self%n_other
        do i = 1, self%s
          lag = (self%now - self%begins(d)) + self%h*self%table%points(i)
          call self%kernels(m)%lag_rule(max(lag - self%lengths(d), &
                                                   self%h*self%table%points(i)), lag, sigma, w)
          weights = 0.0_wp
          do k = 1, size(sigma)
            weights = weights + w(k)*self%table%basis((lag - sigma(k))/self%lengths(d))
          end do
          do c = 1, size(self%kernel_of)
            if (self%kernel_of(c) /= m) cycle
            at = (c - 1)*self%s + i
            remembered(at) = remembered(at) + dot_product(weights, self%g(:, c, d))
          end do
        end do
      end do
    end do
  end subroutine add_others

  subroutine store(self, g)
    class(direct_history_type), intent(inout) :: self
    real(wp), intent(in), contiguous :: g(0:, :)
    real(wp), allocatable :: grown(:, :, :)

    integer :: n

    n = self%n_stored + 1
    if (n > size(self%g, 3)) then
      allocate (grown(0:self%s + 1, size(g, 2), max(16, 2*self%n_stored)))
      grown(:, :, :self%n_stored) = self%g(:, :, :self%n_stored)
      call move_alloc(grown, self%g)
    end if
    self%g(:, :, n) = g
    if (n > size(self%begins)) then
      self%begins = [self%begins, spread(0.0_wp, 1, size(self%g, 3) - size(self%begins))]
      self%lengths = [self%lengths, spread(0.0_wp, 1, size(self%g, 3) - size(self%lengths))]
    end if
    self%begins(n) = self%now
    self%lengths(n) = self%h
    self%n_stored = n
    self%now = self%now + self%h
    n = n - self%n_other
    if (n > self%n_lags) call add_lags(self, merge(2*n, max(16, 2*n), self%n_other > 0))
  end subroutine store

  subroutine change_step(self, h)
    class(direct_history_type), intent(inout) :: self
    real(wp), intent(in) :: h
    if (abs(h - self%h) <= 0.0_wp) return
    self%h = h
    self%n_other = self%n_stored
    self%n_lags = 0
    deallocate (self%weights)
    allocate (self%weights(0:self%s + 1, self%s, 0, size(self%kernels)))
  end subroutine change_step

  !> Weights of lags up to n.
  subroutine add_lags(self, n)
    class(direct_history_type), intent(inout) :: self
    integer, intent(in) :: n
    real(wp), allocatable :: grown(:, :, :, :), sigma(:), w(:)
    integer :: d, i, k, m

    allocate (grown(0:self%s + 1, self%s, n, size(self%kernels)))
    grown = 0.0_wp
    grown(:, :, :self%n_lags, :) = self%weights
    do m = 1, size(self%kernels)
      if (.not. any(self%kernel_of == m)) cycle
      do d = self%n_lags + 1, n
        do i = 1, self%s
          associate (c => self%table%points(i))
            call self%kernels(m)%lag_rule(self%h*(d - 1 + c), self%h*(d + c), sigma, w)
            do k = 1, size(sigma)
              grown(:, i, d, m) = grown(:, i, d, m) &
                                  + w(k)*self%table%basis(d + c - sigma(k)/self%h)
            end do
          end associate
        end do
      end do
    end do
    call move_alloc(grown, self%weights)
    self%n_lags = n
  end subroutine add_lags

  subroutine add_known_past(self, known_past)
    class(direct_history_type), intent(inout) :: self
    type(known_past_type), intent(in) :: known_past
    self%known_past = known_past
  end subroutine add_known_past

  subroutine begin(self, table, past)
    class(direct_history_type), intent(inout) :: self
    type(collocation_type), intent(in) :: table
    type(past_type), intent(in) :: past
    integer :: k, n

    n = size(past%times)
    deallocate (self%times, self%masses)
    allocate (self%times(n + decay_nodes), self%masses(n + decay_nodes, size(self%kernel_of)))
    self%now = self%h
    self%times(:n) = past%times
    self%masses(:n, :) = past%masses
    do k = 1, decay_nodes
      self%times(n + k) = self%h - past%length*(1.0_wp - points_32(k))
      self%masses(n + k, :) = past%length*weights_32(k)*matmul(table%basis(points_32(k)), past%last)
    end do
  end subroutine begin

  pure integer function memory_size(self)
    class(direct_history_type), intent(in) :: self
    memory_size = 5 + size(self%times)*(1 + size(self%kernel_of)) &
                  + (size(self%g, 1)*size(self%g, 2) + 2)*self%n_stored
  end function memory_size

  pure function save_memory(self) result(memory)
    class(direct_history_type), intent(in) :: self
    real(wp) :: memory(self%memory_size())
    memory = [real(self%n_stored, wp), real(size(self%times), wp), real(self%n_other, wp), &
              self%now, self%h, self%times, reshape(self%masses, [size(self%masses)]), &
              self%begins(:self%n_stored), self%lengths(:self%n_stored), &
              reshape(self%g(:, :, :self%n_stored), &
                      [size(self%g, 1)*size(self%g, 2)*self%n_stored])]
  end function save_memory

  subroutine load_memory(self, memory)
    class(direct_history_type), intent(inout) :: self
    real(wp), intent(in) :: memory(:)
    integer :: n, m, at, channels

    n = nint(memory(1))
    m = nint(memory(2))
    channels = size(self%kernel_of)
    self%n_other = nint(memory(3))
    self%now = memory(4)
    if (abs(memory(5) - self%h) > 0.0_wp) self%n_other = n
    self%times = memory(6:m + 5)
    at = m + 5
    self%masses = reshape(memory(at + 1:at + m*channels), [m, channels])
    at = at + m*channels
    self%begins = memory(at + 1:at + n)
    self%lengths = memory(at + n + 1:at + 2*n)
    at = at + 2*n
    self%n_stored = n
    deallocate (self%g)
    allocate (self%g(0:self%s + 1, channels, n))
    self%g(:, :, :) = reshape(memory(at + 1:at + (self%s + 2)*channels*n), &
                              [self%s + 2, channels, n])
    if (n - self%n_other > self%n_lags) call add_lags(self, n - self%n_other)
  end subroutine load_memory

end module viscovib_direct_history
