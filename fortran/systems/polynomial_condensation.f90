!> Condenses polynomial systems to the few coordinates with nonlinear forces or memory.
module viscovib_polynomial_condensation
  use viscovib_dense, only: factorize, solve
  use viscovib_kinds, only: wp
  use viscovib_law_program, only: branches, wall
  use viscovib_law_term, only: law_term
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_reduction, only: reduce
  use viscovib_status, only: status_type
  use viscovib_structure, only: structure_type
  use viscovib_structure_model, only: set_rest, structure_model
  use viscovib_structure_rest, only: new_rest
  implicit none
  private

  public :: condense_polynomial, condenses, is_overdamped, turn_system

  !> Smallest number of coordinates for condensation. At most half of them may have forces or
  !! memory. Smaller systems are as fast without condensation.
  integer, parameter :: smallest = 4
  !> Smallest number of coordinates for stability by the condensed equations without memory, also
  !! per remaining coordinate (measured with 1 to 4 of them). For fewer coordinates monodromy
  !! matrices are faster and give all multipliers. With memory the full determinant takes 10 to 200
  !! times as long.
  integer, parameter :: smallest_checked = 8, checked_each = 3
  !> Smallest number of coordinates for condensation at each speed, which needs all modes there.
  integer, parameter :: smallest_turned = 13
  !> Ratio of damping rate to natural frequency above which integration in time uses modes. The full
  !! equations need steps as short as the decay (equal times measured at ratios of 20 to 70).
  real(wp), parameter :: much_faster = 50.0_wp
  !> Minimum duration of the run in decay times for integration by modes.
  real(wp), parameter :: many_decays = 3000.0_wp

contains

  !> True if condensation makes solutions (and their stability, if requested) faster.
  pure logical function condenses(system, stability)
    type(polynomial_type), intent(in) :: system
    logical, intent(in) :: stability
    integer :: n, q

    n = size(system%mass, 1)
    q = count(touched(system))
    condenses = n >= smallest .and. q > 0 .and. 2*q <= n &
                .and. .not. (allocated(system%space_damping) .or. system%depends_on_speed())
    if (.not. (condenses .and. stability) .or. any(system%kernel_of > 0)) return
    condenses = n >= max(smallest_checked, checked_each*q + 2)
  end function condenses

  !> True if integration by modes, with exact fast decay, is faster: damping rates far exceed the
  !! natural frequencies, the run is long and no law switches.
  logical function is_overdamped(system, t_end)
    type(polynomial_type), intent(in) :: system
    real(wp), intent(in) :: t_end
    real(wp) :: fastest
    real(wp), dimension(size(system%mass, 1), size(system%mass, 1)) :: mass, pull, drag
    integer :: pivots(size(system%mass, 1)), i
    logical :: singular

    is_overdamped = .false.
    if (allocated(system%space_damping) .or. .not. any(touched(system))) return
    do i = 1, size(system%laws)
      if (system%laws(i)%state > 0 .or. any(branches(system%laws(i)%program%code))) return
      ! Another law may be stiff in a thin layer of rates.
      if (.not. is_linear_in_rates(system%laws(i), maxval(abs(system%damping)))) return
    end do
    mass = system%mass
    pull = matmul(system%spread, system%gather)
    drag = system%damping
    call factorize(size(mass, 1), mass, pivots, singular)
    if (singular) return
    do i = 1, size(mass, 1)
      call solve(size(mass, 1), mass, pivots, pull(:, i))
      call solve(size(mass, 1), mass, pivots, drag(:, i))
    end do
    fastest = maxval(sum(abs(drag), 2))
    is_overdamped = fastest*t_end > many_decays &
                    .and. fastest > much_faster*sqrt(maxval(sum(abs(pull), 2)))
  end function is_overdamped

  !> True if the slopes of a law by rates are constant: they are then part of `damping`, whose
  !! largest entry is given, and the slopes of what is left are 0 at all rates.
  logical function is_linear_in_rates(law, damping) result(is_linear)
    type(law_term), intent(in) :: law
    real(wp), intent(in) :: damping
    real(wp), parameter :: places(3) = [0.0_wp, 0.7_wp, -2.3_wp], &
                           speeds(5) = [0.0_wp, 1.0e-3_wp, -0.7_wp, 11.0_wp, -1.0e4_wp], &
                           rounding = 1.0e-12_wp
    real(wp) :: at(size(places)*size(speeds), size(law%arguments, 1)), values(size(at, 1))
    real(wp) :: slopes(size(at, 1), size(at, 2))
    logical :: is_rate(size(at, 2))
    integer :: k

    is_rate = any(abs(law%rates) > 0.0_wp, 2)
    is_linear = .not. any(is_rate)
    if (is_linear) return
    do k = 1, size(at, 2)
      if (is_rate(k)) then
        at(:, k) = [spread(speeds, 1, size(places))]
      else
        at(:, k) = [spread(places, 2, size(speeds))]
      end if
    end do
    call law%program%differentiate(at, values, slopes)
    do k = 1, size(at, 2)
      if (.not. is_rate(k)) slopes(:, k) = 0.0_wp
    end do
    is_linear = all(abs(values) < wall) .and. all(abs(slopes) <= rounding*damping)
  end function is_linear_in_rates

  !> Mask of the coordinates with nonlinear forces or memory.
  pure function touched(system)
    type(polynomial_type), intent(in) :: system
    logical :: touched(size(system%mass, 1))
    integer :: i

    touched = .false.
    do i = 1, size(system%monomials)
      touched(system%monomials(i)%equation) = .true.
      touched(system%monomials(i)%dof) = .true.
    end do
    do i = 1, size(system%laws)
      touched(system%laws(i)%equations) = .true.
      touched = touched .or. any(abs(system%laws(i)%arguments) > 0.0_wp, 1) &
                .or. any(abs(system%laws(i)%rates) > 0.0_wp, 1)
    end do
    do i = 1, size(system%kernel_of)
      if (system%kernel_of(i) == 0) cycle
      touched = touched .or. abs(system%gather(i, :)) > 0.0_wp &
                .or. abs(system%spread(:, i)) > 0.0_wp
    end do
  end function touched

  !> Condense the system without loads. Fails if its compliance is not a sum over modes.
  subroutine condense_polynomial(system, model, condensed, status, roughly)
    type(polynomial_type), intent(in) :: system
    type(structure_model), intent(out) :: model
    type(structure_type), intent(out) :: condensed
    type(status_type), intent(out) :: status
    !> As of `new_rest`.
    logical, intent(in), optional :: roughly
    real(wp), dimension(size(system%mass, 1), size(system%mass, 1)) :: none, unit
    real(wp), allocatable :: weights(:)
    integer :: dofs(count(touched(system))), i, n

    n = size(system%mass, 1)
    none = 0.0_wp
    unit = 0.0_wp
    do i = 1, n
      unit(i, i) = 1.0_wp
    end do
    dofs = pack([(i, i=1, n)], touched(system))
    model%mass = system%mass
    model%damping = system%damping
    ! Elastic forces, also of springs with memory, belong to the linear subsystem. The condensed
    ! system contains their hereditary parts.
    model%stiffness = matmul(system%spread, system%gather)
    model%places = unit
    model%base_direction = system%base_direction
    model%directions = unit(:, dofs)
    allocate (model%elements(0))
    allocate (model%modal%ratios(n), source=0.0_wp)
    call new_rest(model%rest, model%mass, model%damping, model%stiffness, model%places, &
                  model%modal, status, none, roughly)
    if (status%failed()) return
    call set_rest(model, condensed, model%stiffness, weights, status)
    if (status%failed()) return
    call reduce(system, touched(system), condensed%polynomial_type)
    condensed%mass = 0.0_wp
    condensed%damping = 0.0_wp
    do i = 1, size(dofs)
      condensed%mass(i, i) = weights(i)
    end do
    do i = 1, size(condensed%kernel_of)
      if (condensed%kernel_of(i) == 0) condensed%gather(i, :) = 0.0_wp
    end do
    condensed%condensed = .true.
    allocate (condensed%loads(0))
  end subroutine condense_polynomial

  !> The system at a speed (rad/s) for stability: condensed if that is faster.
  subroutine turn_system(system, speed, is_kinked, turned, kept)
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: speed
    !> True if laws have kinks: the system is then not condensed.
    logical, intent(in) :: is_kinked
    class(oscillator_type), allocatable, intent(out) :: turned
    !> The coordinates of the system at the speed, among those of the system.
    integer, allocatable, intent(out) :: kept(:)
    type(structure_model) :: model
    type(structure_type), allocatable :: condensed
    type(status_type) :: status
    integer :: i

    allocate (turned, source=system)
    call turned%set_speed(speed)
    kept = [(i, i=1, system%n_dof())]
    if (is_kinked) return
    select type (turned)
    type is (polynomial_type)
      if (size(kept) < smallest_turned .or. .not. condenses(turned, .true.)) return
      allocate (condensed)
      call condense_polynomial(turned, model, condensed, status, .true.)
      if (status%failed()) return
      kept = pack(kept, touched(turned))
    class default
      return
    end select
    deallocate (turned)
    call move_alloc(condensed, turned)
  end subroutine turn_system

end module viscovib_polynomial_condensation
