!> A motion known before t = 0: straight lines between displacements at times, the
!! first one held before them. What springs remember of it is a polynomial on each
!! piece, integrated with exact weights at any lag.
module viscovib_known_past
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_memory_channels, only: channels_type
  use viscovib_collocation, only: collocation_type, new_collocation
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: known_past_type, new_known_past

  !> Nodes of a piece, which make it exact to rounding for forces of any smoothness
  !! that a step resolves.
  integer, parameter :: nodes = 8

  type :: known_past_type
    type(collocation_type) :: table
    !> Ends of the pieces, ascending to 0, shape (0:n); channels at the points of each,
    !! less what was held, shape (0:nodes+1, n_channels, n).
    real(wp), allocatable :: times(:), g(:, :, :)
  contains
    procedure :: is_known
    procedure :: recall
  end type known_past_type

contains

  subroutine new_known_past(known_past, system, channels, times, u)
    type(known_past_type), intent(out) :: known_past
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    !> Ascending to 0, shape (n+1); none or one: nothing is known.
    real(wp), intent(in) :: times(:)
    !> Displacements, shape (n_dof, n+1).
    real(wp), intent(in) :: u(:, :)
    real(wp) :: points(nodes + 2, size(u, 1) + system%n_rates()), w(nodes + 2, system%n_memory())
    real(wp) :: bend(nodes + 2, system%n_memory())
    integer :: c, d, i, n

    n = max(size(times) - 1, 0)
    call new_collocation(known_past%table, nodes)
    allocate (known_past%times(0:n), known_past%g(0:nodes + 1, size(channels%kernel_of), n))
    known_past%times = 0.0_wp
    if (n == 0) return
    known_past%times(0:n) = times
    do i = 1, n
      do d = 1, size(u, 1)
        points(:, d) = u(d, i) + (u(d, i + 1) - u(d, i))*known_past%table%points
      end do
      do d = 1, system%n_rates()
        points(:, size(u, 1) + d) = (u(system%rates(d), i + 1) - u(system%rates(d), i)) &
                                    /(times(i + 1) - times(i))
      end do
      w = matmul(points(:, :size(u, 1)), transpose(system%gather))
      bend = 0.0_wp
      if (any(system%bent)) call system%deflection_remainder(points, bend)
      do d = 1, system%n_memory()
        if (system%bent(d)) w(:, d) = w(:, d) + bend(:, d)
      end do
      do c = 1, size(channels%kernel_of)
        known_past%g(:, c, i) = matmul(w, channels%gather(c, :)) - channels%held(c)
      end do
    end do
  end subroutine new_known_past

  pure logical function is_known(self)
    class(known_past_type), intent(in) :: self
    is_known = .false.
    if (allocated(self%g)) is_known = size(self%g, 3) > 0
  end function is_known

  !> What is remembered of it at a time t > 0, shape (n_channels).
  subroutine recall(self, kernels, kernel_of, t, remembered)
    class(known_past_type), intent(in) :: self
    !> Kernels, and which of them each channel has.
    type(kernel_holder), intent(in) :: kernels(:)
    integer, intent(in) :: kernel_of(:)
    real(wp), intent(in) :: t
    real(wp), intent(out) :: remembered(:)
    real(wp), allocatable :: sigma(:), w(:)
    real(wp) :: weights(0:nodes + 1), length
    integer :: c, i, j, k

    remembered = 0.0_wp
    do k = 1, size(kernels)
      if (.not. any(kernel_of == k)) cycle
      do i = 1, size(self%g, 3)
        length = self%times(i) - self%times(i - 1)
        call kernels(k)%lag_rule(t - self%times(i), t - self%times(i - 1), sigma, w)
        weights = 0.0_wp
        do j = 1, size(sigma)
          weights = weights + w(j)*self%table%basis((t - sigma(j) - self%times(i - 1))/length)
        end do
        do c = 1, size(kernel_of)
          if (kernel_of(c) /= k) cycle
          remembered(c) = remembered(c) + dot_product(weights, self%g(:, c, i))
        end do
      end do
    end do
  end subroutine recall

end module viscovib_known_past
