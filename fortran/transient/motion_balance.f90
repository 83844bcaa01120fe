!> Accelerations of a motion that is known, from its equations.
module viscovib_motion_balance
  use viscovib_collocation, only: collocation_type, new_collocation
  use viscovib_convolution, only: convolve
  use viscovib_dense, only: factorize, solve_columns
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_memory_channels, only: variables_of
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: accelerations_of, recall, recalled_along

  !> Nodes of the panels of a motion.
  integer, parameter, public :: panel_points = 8

contains

  !> What each hereditary variable remembers at times of a motion, R*w.
  subroutine recalled_along(system, ends, u, rate, held, times, recalled)
    class(oscillator_type), intent(in) :: system
    !> Ends of panels, shape (0:n); coordinates and their rates at the points of each, those of the
    !! first panel first, shape (n (panel_points + 2), n_dof).
    real(wp), intent(in) :: ends(0:)
    real(wp), intent(in), contiguous :: u(:, :), rate(:, :)
    !> Displacement before the first panel, shape (n_dof); times in the panels, ascending.
    real(wp), intent(in) :: held(:), times(:)
    !> Shape (size(times), n_memory).
    real(wp), intent(out) :: recalled(:, :)
    real(wp), allocatable :: w(:, :)
    real(wp) :: first(system%n_memory())

    recalled = 0.0_wp
    if (.not. any(system%kernel_of > 0)) return
    allocate (w(size(u, 1), system%n_memory()))
    call find_variables(system, u, rate, w)
    first = 0.0_wp
    if (any(abs(held) > 0.0_wp)) first = variables_of(system, held)
    call recall(system%kernels, system%kernel_of, ends, w, first, times, recalled)
  end subroutine recalled_along

  !> R*w of quantities w along a motion.
  subroutine recall(kernels, kernel_of, ends, w, first, times, recalled)
    type(kernel_holder), intent(in) :: kernels(:)
    !> The kernel of each quantity, shape (m); 0: none.
    integer, intent(in) :: kernel_of(:)
    !> As of `recalled_along`; the quantities, shape (n (panel_points + 2), m), and before the first
    !! panel, shape (m).
    real(wp), intent(in) :: ends(0:), w(:, :), first(:), times(:)
    !> Shape (size(times), m).
    real(wp), intent(out) :: recalled(:, :)
    type(collocation_type) :: table
    real(wp), allocatable :: g(:, :, :), some(:, :)
    integer, allocatable :: members(:)
    integer :: j, k, n

    recalled = 0.0_wp
    call new_collocation(table, panel_points)
    n = ubound(ends, 1)
    do k = 1, size(kernels)
      members = pack([(j, j=1, size(kernel_of))], kernel_of == k)
      if (size(members) == 0) cycle
      allocate (g(panel_points + 2, n, size(members)), some(size(times), size(members)))
      do j = 1, size(members)
        g(:, :, j) = reshape(w(:, members(j)), [panel_points + 2, n])
      end do
      call convolve(kernels(k), table, ends, g, first(members), times, some)
      do j = 1, size(members)
        recalled(:, members(j)) = some(:, j)
      end do
      deallocate (g, some)
    end do
  end subroutine recall

  !> Hereditary variables w at states.
  subroutine find_variables(system, u, rate, w)
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in), contiguous :: u(:, :), rate(:, :)
    real(wp), intent(out), contiguous :: w(:, :)
    real(wp), allocatable :: seen(:, :), bend(:, :)
    integer :: j

    w = matmul(u, transpose(system%gather))
    if (.not. any(system%bent)) return
    allocate (seen(size(u, 1), size(u, 2) + system%n_rates()), bend(size(w, 1), size(w, 2)))
    seen(:, :size(u, 2)) = u
    do j = 1, system%n_rates()
      seen(:, size(u, 2) + j) = rate(:, system%rates(j))
    end do
    bend = 0.0_wp
    call system%deflection_remainder(seen, bend)
    do j = 1, size(w, 2)
      if (system%bent(j)) w(:, j) = w(:, j) + bend(:, j)
    end do
  end subroutine find_variables

  !> Accelerations at states. `singular`: the mass matrix is.
  subroutine accelerations_of(system, u, rate, load, recalled, a, singular)
    class(oscillator_type), intent(in) :: system
    !> Coordinates, rates and loads, shape (n, n_dof).
    real(wp), intent(in), contiguous :: u(:, :), rate(:, :), load(:, :)
    !> Of the hereditary variables, shape (n, n_memory).
    real(wp), intent(in) :: recalled(:, :)
    !> Shape (n, n_dof).
    real(wp), intent(out) :: a(:, :)
    logical, intent(out) :: singular
    real(wp), allocatable :: w(:, :), force(:, :), right(:, :)
    real(wp) :: mass(system%n_dof(), system%n_dof())
    integer :: pivots(system%n_dof())

    a = 0.0_wp
    mass = system%mass
    call factorize(size(mass, 1), mass, pivots, singular)
    if (singular) return
    allocate (w(size(u, 1), system%n_memory()), force(size(u, 1), size(u, 2)))
    call find_variables(system, u, rate, w)
    w = w - recalled
    force = 0.0_wp
    if (system%moving) then
      call system%moving_remainder(u, rate, w, load, force)
    else if (.not. system%separable) then
      call system%force_remainder(u, w, force)
    end if
    allocate (right, source=transpose(load - force - matmul(rate, transpose(system%damping)) &
                                      - matmul(w, transpose(system%spread))))
    call solve_columns(size(mass, 1), size(right, 2), mass, pivots, right)
    a = transpose(right)
  end subroutine accelerations_of

end module viscovib_motion_balance
