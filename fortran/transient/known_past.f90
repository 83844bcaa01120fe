! Optimize: -O1
!> A prescribed displacement history before t = 0: linear interpolation of given displacements,
!! constant before the first one. The memory channels of it are piecewise polynomials,
!! integrated with exact weights at any lag. A piece that a polynomial does not resolve, as at
!! a corner of a law, is bisected.
module viscovib_known_past
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_memory_channels, only: channels_type
  use viscovib_collocation, only: collocation_type, new_collocation
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: known_past_type, new_known_past

  !> Nodes of a piece; points at which its polynomial is checked; largest number of parts of a
  !! piece; largest number of bisections.
  integer, parameter :: nodes = 8, n_checks = 25, most_parts = 2000, most_halvings = 50
  !> Interpolation error of a part times its length, relative to the size of the channel.
  real(wp), parameter :: resolved = 1.0e-13_wp

  !> A linear displacement: its start, its duration, and its change over the duration.
  type :: line_type
    real(wp) :: begin = 0.0_wp, length = 0.0_wp
    real(wp), allocatable :: u(:), change(:)
  contains
    procedure :: remember
  end type line_type

  type :: known_past_type
    type(collocation_type) :: table
    !> Ends of the pieces, ascending to 0, shape (0:n); channels at the points of each piece,
    !! less the held value, shape (0:nodes+1, n_channels, n).
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
    !> Ascending to 0, shape (n+1). With fewer than two times there is no known history.
    real(wp), intent(in) :: times(:)
    !> Displacements, shape (n_dof, n+1).
    real(wp), intent(in) :: u(:, :)
    type(line_type) :: lines(max(size(times) - 1, 0))
    real(wp), allocatable :: cuts(:), g(:, :), size_of(:), low(:), high(:)
    integer, allocatable :: line_of(:)
    integer :: i, n

    call new_collocation(known_past%table, nodes)
    allocate (low(0), high(0), line_of(0), g(nodes + 2, size(channels%kernel_of)))
    allocate (size_of, source=abs(channels%held))
    do i = 1, size(lines)
      lines(i) = line_type(begin=times(i), length=times(i + 1) - times(i), u=u(:, i), &
                           change=u(:, i + 1) - u(:, i))
      call lines(i)%remember(system, channels, known_past%table%points, g)
      size_of = max(size_of, maxval(abs(g), dim=1))
    end do
    do i = 1, size(lines)
      call resolve(known_past%table, system, channels, lines(i), size_of, cuts)
      n = size(cuts)
      low = [low, cuts(:n - 1)]
      high = [high, cuts(2:)]
      line_of = [line_of, spread(i, 1, n - 1)]
    end do
    n = size(low)
    allocate (known_past%times(0:n), known_past%g(0:nodes + 1, size(channels%kernel_of), n))
    known_past%times = 0.0_wp
    if (n == 0) return
    known_past%times(0) = times(1)
    do i = 1, n
      associate (line => lines(line_of(i)))
        known_past%times(i) = line%begin + high(i)*line%length
        if (high(i) >= 1.0_wp) known_past%times(i) = times(line_of(i) + 1)
        call line%remember(system, channels, &
                           low(i) + (high(i) - low(i))*known_past%table%points, g)
        known_past%g(:, :, i) = g
      end associate
    end do
  end subroutine new_known_past

  !> Channels, less the held value, at fractions of a line; shape (n, n_channels).
  subroutine remember(self, system, channels, parts, g)
    class(line_type), intent(in) :: self
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    real(wp), intent(in) :: parts(:)
    real(wp), intent(out) :: g(:, :)
    real(wp) :: points(size(parts), size(self%u) + system%n_rates())
    real(wp), dimension(size(parts), system%n_memory()) :: w, bend
    integer :: d

    do d = 1, size(self%u)
      points(:, d) = self%u(d) + self%change(d)*parts
    end do
    do d = 1, system%n_rates()
      points(:, size(self%u) + d) = self%change(system%rates(d))/self%length
    end do
    w = matmul(points(:, :size(self%u)), transpose(system%gather))
    bend = 0.0_wp
    if (any(system%bent)) call system%deflection_remainder(points, bend)
    do d = 1, system%n_memory()
      if (system%bent(d)) w(:, d) = w(:, d) + bend(:, d)
    end do
    g = matmul(w, transpose(channels%gather)) - spread(channels%held, 1, size(parts))
  end subroutine remember

  !> Split a line into parts, from 0 to 1, that a polynomial resolves. A part is bisected until its
  !! interpolation error times its length is at rounding level. The part around a corner or jump
  !! of a law becomes so short that it has no weight.
  subroutine resolve(table, system, channels, line, size_of, cuts)
    type(collocation_type), intent(in) :: table
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    type(line_type), intent(in) :: line
    !> Sizes of the channels, shape (n_channels).
    real(wp), intent(in) :: size_of(:)
    real(wp), allocatable, intent(out) :: cuts(:)
    real(wp) :: low, high, shortest, off(size(size_of))
    real(wp) :: g(nodes + 2, size(size_of)), between(n_checks, size(size_of))
    real(wp) :: by_nodes(n_checks, nodes + 2), checks(n_checks)
    ! Ends of the parts that are not yet checked, the next one last.
    real(wp) :: ends(most_halvings + 1)
    integer :: i, n

    allocate (cuts(1), source=0.0_wp)
    ends(1) = 1.0_wp
    n = 1
    checks = [((i - 0.5_wp)/n_checks, i=1, n_checks)]
    do i = 1, n_checks
      by_nodes(i, :) = table%basis(checks(i))
    end do
    shortest = max(2.0_wp**(-most_halvings), 16.0_wp*spacing(line%begin)/line%length)
    do while (n > 0)
      low = cuts(size(cuts))
      high = ends(n)
      off = 0.0_wp
      if (any(system%bent) .and. high - low > shortest .and. size(cuts) < most_parts) then
        call line%remember(system, channels, low + (high - low)*table%points, g)
        call line%remember(system, channels, low + (high - low)*checks, between)
        off = maxval(abs(matmul(by_nodes, g) - between), dim=1)*(high - low)
      end if
      if (any(off > resolved*size_of)) then
        n = n + 1
        ends(n) = 0.5_wp*(low + high)
      else
        cuts = [cuts, high]
        n = n - 1
      end if
    end do
  end subroutine resolve

  pure logical function is_known(self)
    class(known_past_type), intent(in) :: self
    is_known = .false.
    if (allocated(self%g)) is_known = size(self%g, 3) > 0
  end function is_known

  !> Memory integrals of this history at a time t > 0, shape (n_channels).
  subroutine recall(self, kernels, kernel_of, t, remembered)
    class(known_past_type), intent(in) :: self
    !> Kernels, and the index of the kernel of each channel.
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
