!> A structure without damping, memory and loads, and its undamped modes.
module viscovib_free_structure
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_load, only: new_load
  use viscovib_status, only: fail, status_input_error, status_type
  use viscovib_structure, only: structure_type
  use viscovib_structure_model, only: add_linear, condense, structure_model
  use viscovib_structure_rest, only: is_symmetric, modal_damping, new_rest, rest_type
  implicit none
  private

  public :: free_structure, structure_modes

contains

  !> The structure without damping, memory and loads. Deflection 1 observes coordinate `place`.
  subroutine free_structure(model, place, free, system, status)
    type(structure_model), intent(in) :: model
    integer, intent(in) :: place
    type(structure_model), intent(out) :: free
    type(structure_type), intent(out) :: system
    type(status_type), intent(out) :: status
    type(kernel_holder) :: none(0)
    complex(wp) :: nothing(size(model%places, 1), 0)
    integer :: i, j

    free%mass = model%mass
    free%stiffness = model%stiffness
    free%damping = 0.0_wp*model%damping
    free%places = model%places
    free%modal%ratios = 0.0_wp*model%modal%ratios
    free%base_direction = 0.0_wp*model%base_direction
    allocate (free%elements(size(model%elements) + 1))
    free%elements(2:) = model%elements
    associate (watched => free%elements(1))
      watched%direction = 0.0_wp*model%places(:, 1)
      watched%direction(place) = 1.0_wp
      watched%is_watched = .true.
      allocate (watched%laws(0))
    end associate
    do i = 2, size(free%elements)
      associate (one => free%elements(i))
        one%kernel = 0
        one%damping = 0.0_wp
        if (allocated(one%mix)) deallocate (one%mix)
        do j = 1, size(one%laws)
          one%laws(j)%kernel = 0
        end do
      end associate
    end do
    call condense(free, none, system, status)
    if (status%failed()) return
    call new_load(free%load, size(nothing, 1), [integer ::], nothing, [complex(wp) ::], status)
  end subroutine free_structure

  !> Undamped modes, including the linear stiffness of elements.
  subroutine structure_modes(model, omega, shapes, status)
    type(structure_model), intent(in) :: model
    !> Circular frequencies (rad/s), negative for a negative square. Mode shapes of the observed
    !! coordinates, largest entry 1, shape (n_places, n).
    real(wp), intent(out) :: omega(:), shapes(:, :)
    type(status_type), intent(out) :: status
    real(wp), dimension(size(model%mass, 1), size(model%mass, 1)) :: stiffness, damping, low
    type(rest_type) :: rest
    type(modal_damping) :: none
    integer :: i

    call add_linear(model, stiffness, damping, low)
    damping = 0.0_wp
    if (.not. is_symmetric(stiffness)) then
      call fail(status, status_input_error, 'stiffness', 'stiffness: must be symmetric for modes ' &
                //'without damping')
      return
    end if
    none%ratios = 0.0_wp*model%modal%ratios
    call new_rest(rest, model%mass, damping, stiffness, model%places, none, status, low)
    if (status%failed()) return
    omega = sign(sqrt(abs(rest%squares)), rest%squares)
    do i = 1, size(omega)
      associate (largest => rest%shapes(maxloc(abs(rest%shapes(:, i)), 1), i))
        shapes(:, i) = rest%shapes(:, i)
        if (abs(largest) > 0.0_wp) shapes(:, i) = rest%shapes(:, i)/largest
      end associate
    end do
  end subroutine structure_modes

end module viscovib_free_structure
