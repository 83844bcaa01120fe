!> Condenses polynomial systems to the few coordinates with nonlinear forces or memory.
module viscovib_polynomial_condensation
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_reduction, only: reduce
  use viscovib_status, only: status_type
  use viscovib_structure, only: structure_type
  use viscovib_structure_model, only: set_rest, structure_model
  use viscovib_structure_rest, only: new_rest
  implicit none
  private

  public :: condense_polynomial, condenses, touched, turn_system

  !> Smallest number of coordinates for condensation. At most half of them may have forces or
  !! memory. Smaller systems are as fast without condensation.
  integer, parameter :: smallest = 4
  !> Smallest number of coordinates for stability by the condensed equations without memory, for up
  !! to two coordinates with forces and for more of them (equal times measured). With memory the
  !! full determinant takes 10 to 200 times as long.
  integer, parameter :: smallest_checked(2) = [6, 8]
  !> Smallest number of coordinates for condensation at each speed, which needs all modes there.
  integer, parameter :: smallest_turned = 13

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
    condenses = n >= smallest_checked(merge(1, 2, q <= 2))
  end function condenses

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
    call set_rest(model, condensed, weights, status)
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
